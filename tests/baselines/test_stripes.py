"""Columns and rows of single frames: midway equalisation, whole and over local widths, and guided filters."""

import numpy as np
import pytest

from deepir.baselines.single_frame import mire
from deepir.baselines.single_frame.admire import denoise, equalise_locally, local_variation
from deepir.baselines.single_frame.guided_1d import estimate_stripes, guided_filter
from deepir.baselines.single_frame.mire import equalise, midway_equalise
from deepir.metrics import scores


@pytest.fixture
def flat():
    """A picture whose columns all hold the same values, each in an order of its own."""
    return np.stack([np.roll(np.linspace(0, 1, 60), -x // 3) for x in range(80)], 1)


def test_columns_with_one_histogram_stay(flat):
    assert np.allclose(midway_equalise(flat, 3.0), flat)
    values = np.linspace(0, 1, 96)
    frame = np.stack([np.roll(values, x) for x in range(128)], 1)
    assert np.allclose(equalise_locally(frame, 8.0), frame)


def test_any_increasing_response_of_columns_is_undone_if_all_see_the_same_values(flat):
    # Not only gain and offset: the method is blind to what the response is.
    rng = np.random.default_rng(1)
    response = np.exp(0.2 * rng.standard_normal(80)) * flat ** np.exp(0.2 * rng.standard_normal(80))
    before, after = (scores(each, flat)["psnr_aligned"] for each in (response, equalise(response)))
    assert after > before + 10


def test_the_mean_and_the_order_within_a_column_are_kept(flat):
    tilted = flat + np.linspace(0, 3, 80)
    assert midway_equalise(tilted, 8.0).mean() == pytest.approx(tilted.mean(), rel=1e-12)
    noisy = flat + np.random.default_rng(2).standard_normal(flat.shape)
    assert np.array_equal(midway_equalise(noisy, 2.0).argsort(axis=0), noisy.argsort(axis=0))


def scene(height=96, width=128):
    """Plain on the left, and textured on the right."""
    y, x = np.mgrid[:height, :width] / height
    return np.sin(3 * y + 2 * x) + (x > 0.7) * 0.5 * np.sin(25 * x + 9 * y)


def columns(deviation, seed=0):
    return deviation * np.random.default_rng(seed).standard_normal(128)


def test_offsets_of_columns_go_and_a_plain_and_a_textured_part_choose_their_widths():
    striped = scene() + columns(0.2)
    before, after = (
        scores(each, scene())["psnr_aligned"] for each in (striped, equalise_locally(striped, 32.0))
    )
    assert after > before + 7
    local, everywhere = (each - scene() for each in (equalise_locally(striped, 16.0), mire.equalise(striped)))
    assert not np.array_equal(local, everywhere)
    assert local.std() < everywhere.std()


def test_a_wide_mean_chooses_one_width_as_mire_does():
    striped = scene() + columns(0.1)
    assert np.allclose(equalise_locally(striped, 500.0), mire.equalise(striped))


def test_the_variation_is_a_local_mean():
    step = np.repeat([[0.0] * 20 + [1.0] * 20], 30, axis=0)
    found = local_variation(step, 2.0)
    assert found.sum() == pytest.approx(30, rel=1e-6)
    assert found[:, 19].min() > 100 * found[:, 5].max()


def test_white_noise_is_less_and_a_frame_without_any_stays():
    noise = 0.1 * np.random.default_rng(1).standard_normal(scene().shape)
    assert (denoise(scene() + noise) - scene()).std() < 0.5 * noise.std()
    flat = np.repeat(np.repeat([[1.0, 2.0], [3.0, 5.0]], 48, 0), 64, 1)
    assert np.allclose(denoise(flat), flat, atol=1e-5)


def frame():
    y, x = np.mgrid[:64, :80] / 80
    return 0.3 + 0.3 * x + 0.2 * np.sin(3 * y + 2 * x)


def test_stripes_that_go_with_the_scene_are_found():
    scene = frame()
    gain = 1 + 0.02 * np.random.default_rng(0).standard_normal(80)
    found = estimate_stripes(gain * scene, 2, 0.4, 1.0)
    sharp = (gain - 1) * scene
    assert np.corrcoef(found.ravel(), sharp.ravel())[0, 1] > 0.85
    assert (gain * scene - found - scene).std() < 0.55 * sharp.std()


def test_a_smooth_scene_without_stripes_stays():
    assert np.abs(estimate_stripes(frame(), 2, 0.4, 1.0))[:, 5:-5].max() < 1e-3


def test_what_is_linear_in_the_guide_passes():
    guide = np.random.default_rng(1).random((30, 40))
    assert np.allclose(guided_filter(guide, 3 * guide + 2, 7, 1e-12, axis=0), 3 * guide + 2)


def test_an_edge_far_above_the_ridge_is_not_blurred():
    step = np.repeat([[0.0] * 20 + [1.0] * 20], 10, axis=0)
    assert np.abs(guided_filter(step, step, 7, 1e-4, axis=1) - step).max() < 1e-3
    assert np.abs(guided_filter(step, step, 7, 1e4, axis=1) - step).max() > 0.3
