"""Midway equalisation over local widths, and a cosine transform's threshold."""

import numpy as np
import pytest

from deepir.baselines.single_frame import mire
from deepir.baselines.single_frame.admire import denoise, equalise_locally, local_variation
from deepir.metrics import scores


def scene(height=96, width=128):
    """Plain on the left, and textured on the right."""
    y, x = np.mgrid[:height, :width] / height
    return np.sin(3 * y + 2 * x) + (x > 0.7) * 0.5 * np.sin(25 * x + 9 * y)


def columns(deviation, seed=0):
    return deviation * np.random.default_rng(seed).standard_normal(128)


def test_offsets_of_columns_go_away():
    striped = scene() + columns(0.2)
    before, after = (
        scores(each, scene())["psnr_aligned"] for each in (striped, equalise_locally(striped, 32.0))
    )
    assert after > before + 7


def test_a_plain_and_a_textured_part_choose_different_widths():
    striped = scene() + columns(0.2)
    local, everywhere = (each - scene() for each in (equalise_locally(striped, 16.0), mire.equalise(striped)))
    assert not np.array_equal(local, everywhere)
    assert local.std() < everywhere.std()


def test_a_wide_mean_chooses_one_width_as_mire_does():
    striped = scene() + columns(0.1)
    assert np.allclose(equalise_locally(striped, 500.0), mire.equalise(striped))


def test_columns_with_one_histogram_stay():
    values = np.linspace(0, 1, 96)
    frame = np.stack([np.roll(values, x) for x in range(128)], 1)
    assert np.allclose(equalise_locally(frame, 8.0), frame)


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
