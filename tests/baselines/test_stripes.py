"""Columns and rows of single frames: midway equalisation, guided filters, and a trained network."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.transform import resize

from deepir.baselines.stripes import (
    denoise,
    destripe_cnn,
    equalise_locally,
    estimate_stripes,
    guided_filter,
    local_variation,
    midway_equalise,
    mire,
)
from deepir.baselines.super_resolution import sharpen
from deepir.metrics import scores
from deepir.simulate.scenes.procedural import load_picture, procedural


@pytest.fixture
def flat():
    """A picture whose columns all hold the same values, each in an order of its own."""
    rng = np.random.default_rng(0)
    values = np.linspace(0, 1, 60)
    return np.stack([np.roll(values, -x // 3) for x in range(80)], 1) + 0 * rng.random()


def test_columns_with_one_histogram_stay(flat):
    assert np.allclose(midway_equalise(flat, 3.0), flat)
    assert np.allclose(equalise_locally(flat, 8.0), flat)


def test_any_increasing_response_of_columns_is_undone_if_all_see_the_same_values(flat):
    # Not only gain and offset: the method is blind to what the response is.
    rng = np.random.default_rng(1)
    response = np.exp(0.2 * rng.standard_normal(80)) * flat ** np.exp(0.2 * rng.standard_normal(80))
    before, after = (scores(each, flat)["psnr_aligned"] for each in (response, mire(response)))
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


def columns(deviation):
    return deviation * np.random.default_rng(0).standard_normal(128)


def test_offsets_of_columns_go_away_and_a_plain_and_a_textured_part_choose_different_widths():
    striped = scene() + columns(0.2)
    local, everywhere, before = (each - scene() for each in (equalise_locally(striped, 32.0), mire(striped), striped))
    assert local.std() < 10 ** (-7 / 20) * before.std()  # 7 dB
    assert not np.array_equal(local, everywhere)
    assert local.std() < everywhere.std()
    assert np.allclose(equalise_locally(striped, 500.0), mire(striped))  # a wide mean chooses one width


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


# ---- a trained network, on pictures that it did not learn from ----


def picture(name="camera"):
    return resize(load_picture(name), (96, 128), anti_aliasing=True)


def striped(clean, gain=0.15, offset=0.02):
    gains, offsets = np.random.default_rng(0).standard_normal((2, clean.shape[1]))
    return clean * (1 + gain * gains) + offset * offsets


@pytest.mark.parametrize("name", ["camera", "moon", "astronaut", "drawing"])
def test_columns_are_taken_out_of_a_fresh_picture_by_five_decibels_at_least(name):
    clean = procedural(1, (96, 128)) if name == "drawing" else picture(name)
    before, after = (scores(each, clean)["psnr_aligned"] for each in (striped(clean), destripe_cnn(striped(clean))))
    assert after > before + 5


def test_stripes_on_a_flat_field_are_found_within_a_fifth():
    stripes = striped(np.zeros((96, 128)))
    assert (destripe_cnn(stripes) - stripes.mean())[:, 4:-4].std() < 0.2 * stripes.std()


def test_rows_are_the_scenes():
    # The same stripes turned: nothing says that they are the sensor's.
    rows = striped(picture().T).T - picture()
    left = destripe_cnn(picture() + rows) - destripe_cnn(picture())
    assert np.corrcoef(left.ravel(), rows.ravel())[0, 1] > 0.95


def test_the_level_stays():
    frame = 8000 + 1500 * striped(picture())
    assert destripe_cnn(frame).mean() == pytest.approx(frame.mean(), rel=1e-6)


@pytest.mark.parametrize("network", [destripe_cnn, sharpen])
@settings(max_examples=5, deadline=None)
@given(gain=st.floats(1e-2, 1e4), level=st.floats(-10, 10), height=st.integers(9, 40), width=st.integers(9, 40))
def test_units_and_size_are_free(network, gain, level, height, width):
    frame = np.random.default_rng(height).random((height, width))
    assert np.allclose(network(gain * (frame + level)) / gain - level, network(frame), atol=1e-4)
