"""A shutter that closes within a burst leaves another pattern: only frames of one pattern are put together."""

import numpy as np
import pytest

import deepir
from deepir.simulate import Settings, simulate

CAMERA = Settings(n_frames=8, shape=(80, 96), counts=True, shading=0.0, dead_pixels=0.0)


def burst(seed, at):
    """A burst whose offsets are others from frame `at` on, and its truth."""
    sim = simulate(None, CAMERA, seed=seed)
    frames = sim.frames.astype(np.float32)
    frames[at:] += np.random.default_rng(seed).normal(0, 60, frames.shape[1:])
    return frames, sim.truth


@pytest.mark.parametrize(("at", "used"), [(5, range(5)), (3, range(3, 8)), (4, range(4))])
def test_the_longer_part_is_used(at, used):
    frames, truth = burst(2, at)
    result = deepir.run("nuc", frames=frames, threads=1)
    assert np.flatnonzero(result.frames_used).tolist() == list(used)
    assert any(f"between frames {at - 1} and {at}" in message for message in result.messages)
    if used[0] == 0:
        error = result.scene - truth.scene
        assert (error - error.mean()).std() < 0.03 * CAMERA.contrast


@pytest.mark.parametrize("seed", [2, 3])
def test_a_burst_of_one_pattern_is_used_whole(seed):
    frames, _ = burst(seed, 8)
    assert deepir.run("nuc", frames=frames, threads=1).frames_used.all()


def test_a_camera_that_rests_in_two_places_is_no_shutter():
    sim = simulate(None, CAMERA, seed=4)
    noise = np.random.default_rng(0).normal(0, 5, (2, *sim.frames.shape[1:]))
    frames = np.concatenate([sim.frames[:1] + noise, sim.frames[1:2] + noise[::-1]])
    result = deepir.run("nuc", frames=frames, threads=1)
    assert result.frames_used.all()
