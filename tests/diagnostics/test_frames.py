"""A shutter that closes within a burst: another pattern."""

import numpy as np
import pytest

import deepir
from tests.effects.solved import burst, error


def closed(at):
    """Frames of a burst whose offsets are others from frame `at` on, and the burst."""
    sim = burst(2, n_frames=8)
    frames = sim.frames.astype(np.float32)
    frames[at:] += np.random.default_rng(2).normal(0, 60, frames.shape[1:])
    return frames, sim


@pytest.mark.parametrize(("at", "used"), [(5, range(5)), (3, range(3, 8)), (4, range(4))])
def test_the_longer_part_is_used(at, used):
    frames, sim = closed(at)
    result = deepir.run("nuc", frames=frames, threads=1)
    assert np.flatnonzero(result.frames_used).tolist() == list(used)
    assert any(f"between frames {at - 1} and {at}" in message for message in result.messages)
    if used[0] == 0:
        assert error(result, sim) < 0.03 * sim.settings.contrast


def test_a_camera_that_rests_in_two_places_is_no_shutter():
    sim = burst(4, n_frames=8)
    noise = np.random.default_rng(0).normal(0, 5, (2, *sim.frames.shape[1:]))
    frames = np.concatenate([sim.frames[:1] + noise, sim.frames[1:2] + noise[::-1]])
    result = deepir.run("nuc", frames=frames, threads=1)
    assert result.frames_used.all()
