"""Modes of long periods of an offset, and what frames tell of them."""

import numpy as np
from skimage import data

from deepir.recording.burst import Burst
from deepir.recording.joint_solve import low_order_step
from deepir.recording.modes import LowOrderModes, PatternPrior, dct


def test_a_slope_along_either_axis_is_made_of_modes_exactly():
    modes = LowOrderModes((48, 64), 16.0, slopes=True)
    for slope in np.indices((48, 64)) - np.array([23.5, 31.5])[:, None, None]:
        np.testing.assert_allclose(modes.synthesise(modes.analyse(slope)), slope, atol=1e-10)


def test_the_drift_of_levels_is_found_whatever_offset_is_known_so_far():
    rng, size = np.random.default_rng(4), (48, 64)
    shifts = np.stack([2 * np.arange(16), np.round(12 * np.sin(np.arange(16)))], 1).astype(int)
    levels, fine = np.cumsum(rng.normal(0, 3, 16)), rng.normal(0, 4, size)
    scenes = [data.camera()[200 + y : 248 + y, 200 + x : 264 + x] for y, x in shifts]
    frames = np.stack(scenes) + levels[:, None, None] + fine + rng.normal(0, 1, (16, *size))
    motion = np.tile(np.eye(3), (16, 1, 1))
    motion[:, :2, 2] = shifts[:, ::-1]
    modes = LowOrderModes(size, 16.0, slopes=True)
    for start in (fine, fine + np.linspace(-20, 20, 48)[:, None]):
        burst = Burst(frames.astype(np.float32), np.ones(frames.shape, bool), motion, 0)
        burst.weigh(start, np.ones(size), 0.1, robust=False)
        low_order_step([burst], modes, PatternPrior(dct(fine)), start, np.ones(size))
        assert 9 / 10 < burst.level_variance < 9 * 10  # decades are tried
