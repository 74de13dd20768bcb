"""Shift and add."""

import numpy as np

from deepir.baselines.registered.shift_and_add import accumulate


def shifted(picture, factor, shifts):
    """Every `factor`-th pixel of a picture from each start, and the motion that says so."""
    frames = np.stack([picture[y::factor, x::factor] for y, x in shifts])
    motion = np.tile(np.eye(3), (len(shifts), 1, 1))
    motion[:, :2, 2] = [((x - 0.5) / factor, (y - 0.5) / factor) for y, x in shifts]
    return frames, motion


def test_samples_on_the_fine_grid_give_the_picture_back():
    picture = np.random.default_rng(0).random((16, 20))
    frames, motion = shifted(picture, 2, [(0, 0), (0, 1), (1, 0), (1, 1)])
    assert np.allclose(accumulate(frames, np.ones(frames.shape, bool), motion, (16, 20)), picture, atol=1e-6)


def test_holes_are_interpolated():
    y, x = np.mgrid[:16, :20]
    frames, motion = shifted(0.1 * x + 0.2 * y, 2, [(0, 0), (1, 1)])
    found = accumulate(frames, np.ones(frames.shape, bool), motion, (16, 20))
    assert np.abs(found - (0.1 * x + 0.2 * y))[2:-2, 2:-2].max() < 0.1


def test_samples_that_are_not_valid_do_not_count():
    picture = np.ones((16, 20))
    frames, motion = shifted(picture, 2, [(0, 0), (0, 1), (1, 0), (1, 1)])
    frames[:, 3, 4] = 1e6
    assert np.allclose(accumulate(frames, frames < 2, motion, (16, 20)), 1)
