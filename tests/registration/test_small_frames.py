"""Frames of 24 x 32 px and the like, as cameras of a few euros have: few pixels to find the motion from."""

import numpy as np
import pytest
import torch
from registered import apart

import deepir
from deepir.errors import DataError
from deepir.registration import register
from deepir.simulate import Settings, simulate

COUNTS = {"counts": True, "shading": 0.0, "dead_pixels": 0.0, "max_shift": 4.0}


def small(seed, n_frames=5, shape=(24, 32), **effects):
    return simulate(None, Settings(n_frames=n_frames, shape=shape, **(COUNTS | effects)), seed=seed)


@pytest.mark.parametrize(
    ("seed", "n_frames", "side"), [(1, 3, 24), (9, 3, 24), (1, 3, 33), (5, 3, 33), (7, 3, 33), (7, 5, 33)]
)
def test_the_likeliest_shifts_are_found_where_residuals_are_ruled_by_the_pattern(seed, n_frames, side):
    sim = small(seed, n_frames, (side, {24: 32, 33: 47}[side]))
    result = register(torch.from_numpy(sim.frames.astype(np.float32)))
    assert apart(sim, result.motion.numpy()[:, :2, 2]) < 0.2


@pytest.mark.parametrize("n_frames", [3, 5, 10])
def test_small_frames_that_do_not_move_are_refused(n_frames):
    with pytest.raises(DataError, match=r"do not move|is it one scene"):
        deepir.run("nuc", frames=small(1, n_frames, max_shift=0.0).frames, threads=1)


@pytest.mark.parametrize("shape", [(20, 400), (400, 20)])
def test_a_strip_is_registered_at_its_own_size(shape):
    """Means over blocks, as of other large frames, would leave nothing across it."""
    sim = small(1, 6, shape)
    result = register(torch.from_numpy(sim.frames.astype(np.float32)))
    assert result.used.sum() > 2
