"""Constant statistics."""

import numpy as np

from deepir.baselines.online import last_of
from deepir.baselines.temporal.constant_statistics import equalised_statistics, running_statistics


def test_gain_and_offset_are_found_where_all_pixels_see_the_same_statistics():
    rng = np.random.default_rng(0)
    gain, offset = 1 + 0.1 * rng.standard_normal((8, 9)), 20 * rng.standard_normal((8, 9))
    found_gain, found_offset = equalised_statistics(gain * rng.uniform(0, 100, (4000, 8, 9)) + offset)
    assert np.abs(found_gain - gain / gain.mean()).max() < 0.05
    assert np.corrcoef(found_offset.ravel(), offset.ravel())[0, 1] > 0.98


def test_frames_that_do_not_change_have_no_gain():
    frame = np.random.default_rng(2).random((3, 4))
    gain, offset = equalised_statistics(np.stack([frame, frame]))
    assert np.allclose(gain, 1)
    assert np.allclose(offset, frame - frame.mean())


def test_the_recursion_gives_the_mean():
    frames = np.random.default_rng(1).random((7, 3, 4))
    assert np.allclose(last_of(running_statistics(frames))[0], frames.mean(0))
