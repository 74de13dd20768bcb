"""Constant statistics."""

import numpy as np

from deepir.baselines.online import last_of
from deepir.baselines.temporal.constant_statistics import running_statistics


def test_gain_and_offset_are_found_where_all_pixels_see_the_same_statistics():
    rng = np.random.default_rng(0)
    gain, offset = 1 + 0.1 * rng.standard_normal((8, 9)), 20 * rng.standard_normal((8, 9))
    frames = gain * rng.uniform(0, 100, (4000, 8, 9)) + offset
    mean, deviation = last_of(running_statistics(frames))
    found = deviation / deviation.mean()
    assert np.abs(found - gain / gain.mean()).max() < 0.05
    assert np.corrcoef((mean - found * mean.mean()).ravel(), offset.ravel())[0, 1] > 0.98


def test_the_recursion_gives_the_mean():
    frames = np.random.default_rng(1).random((7, 3, 4))
    assert np.allclose(last_of(running_statistics(frames))[0], frames.mean(0))
