"""What a built-in scene must offer to every problem."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.simulate.scenes.procedural import SCENE_PAINTERS, procedural, sky

SHAPE = (256, 320)
SEEDS = range(2 * len(SCENE_PAINTERS))


@pytest.fixture(scope="module", params=SEEDS)
def picture(request):
    return procedural(request.param, SHAPE)


def test_a_scene_fills_zero_to_one(picture):
    assert picture.shape == SHAPE
    assert picture.dtype == np.float64
    assert picture.min() == 0
    assert picture.max() == 1
    assert picture.std() > 0.1


def test_a_scene_has_smooth_regions_and_sharp_edges(picture):
    slope = ndimage.gaussian_gradient_magnitude(picture, 0.7)
    assert np.mean(slope < 0.01) > 0.2
    assert np.mean(slope > 0.06) > 0.02


def test_edges_are_anti_aliased(picture):
    second = np.abs(np.diff(picture, axis=1))
    strong = np.maximum(second[:, 1:], second[:, :-1]) > 0.2
    both = np.minimum(second[:, 1:], second[:, :-1])[strong] > 0.02
    assert both.mean() > 0.3


def test_no_shift_but_none_makes_a_scene_look_like_itself(picture):
    flat = picture - ndimage.gaussian_filter(picture, 20)
    correlation = np.fft.irfft2(np.abs(np.fft.rfft2(flat)) ** 2, SHAPE)
    correlation /= correlation[0, 0]
    y, x = (np.minimum(np.arange(n), n - np.arange(n)) for n in SHAPE)
    assert correlation[np.hypot(y[:, None], x) > 8].max() < 0.7


def test_the_seed_decides_everything():
    np.testing.assert_array_equal(procedural(3, (64, 80)), procedural(3, (64, 80)))
    same_kind = procedural(0, SHAPE), procedural(len(SCENE_PAINTERS), SHAPE)
    assert np.corrcoef(*(p.ravel() for p in same_kind))[0, 1] < 0.95


def test_the_layout_scales_with_the_height():
    coarse, fine = procedural(0, (128, 160)), procedural(0, (512, 640))
    assert np.corrcoef(coarse.ravel(), fine.reshape(128, 4, 160, 4).mean((1, 3)).ravel())[0, 1] > 0.9


@pytest.mark.parametrize("shape", [(40, 300), (300, 40), (33, 47)])
def test_any_shape_is_drawn(shape):
    for seed in range(len(SCENE_PAINTERS)):
        assert np.isfinite(procedural(seed, shape)).all()


@pytest.mark.parametrize("seed", range(4))
def test_a_sky_is_smooth_but_for_a_strip_at_the_bottom(seed):
    picture = sky(seed, SHAPE)
    assert picture.min() == 0
    assert picture.max() == 1
    slope = ndimage.gaussian_gradient_magnitude(picture, 0.7)
    assert np.mean(slope[: int(0.8 * SHAPE[0])] < 0.01) > 0.9
    assert picture[-10:].mean() > picture[:200].max(initial=0, where=picture[:200] < 0.4) + 0.2
    upper = picture[:150].mean(1)
    assert (np.diff(ndimage.uniform_filter(upper, 30)[15:-15]) > 0).mean() > 0.9  # warmer towards the horizon
    assert slope[int(0.6 * SHAPE[0]) :].max() > 0.1  # land, and a mast
    np.testing.assert_array_equal(picture, sky(seed, SHAPE))
    assert not np.array_equal(picture, sky(seed + 4, SHAPE))
