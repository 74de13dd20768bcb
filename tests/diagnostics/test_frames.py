"""Interlaced frames: every second row is of another time. A shutter that closes within a burst: another pattern."""

import dataclasses

import numpy as np
import pytest
import torch

import deepir
from deepir.diagnostics.frames import are_interlaced
from deepir.registration import register
from deepir.simulate import Settings, simulate
from tests.effects.solved import burst, error, solved

CAMERA = Settings(n_frames=10, shape=(80, 96), max_shift=3.0, shading=0.0, dead_pixels=0.0)


def interlaced(seed, camera=CAMERA):
    """Five frames, each with the even rows of one time and the odd rows of another."""
    frames = simulate(None, camera, seed=seed).frames.astype(np.float32)
    both = frames[::2].copy()
    both[:, 1::2] = frames[1::2, 1::2]
    return both


def reported(frames):
    frames = torch.from_numpy(frames.astype(np.float32))
    return are_interlaced(frames, register(frames).motion)


def test_interlaced_frames_are_reported_and_every_second_row_of_them_is_sound():
    frames = interlaced(3)
    messages = deepir.run("nuc", frames=frames, threads=1).messages
    assert any("interlaced" in message and "frames[:, ::2]" in message for message in messages)
    assert not reported(frames[:, ::2])


@pytest.mark.parametrize("seed", [4, 5])
def test_a_px_between_the_fields_is_enough(seed):
    assert reported(interlaced(seed, dataclasses.replace(CAMERA, max_shift=1.0)))


@pytest.mark.parametrize(
    "effects",
    [
        {},
        {"row_noise": 0.01},
        {"max_rotation": 5.0},
        {"walker": 0.5},
        {"shape": (24, 32)},
        {"shape": (400, 90)},
    ],
)
def test_rows_of_one_time_are_not_apart(effects):
    sim = simulate(None, dataclasses.replace(CAMERA, n_frames=5, **effects), seed=6)
    assert not reported(sim.frames)


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


@pytest.mark.parametrize("seed", [2, 3])
def test_a_burst_of_one_pattern_is_used_whole(seed):
    assert solved(seed=seed, n_frames=8)[0].frames_used.all()


def test_a_camera_that_rests_in_two_places_is_no_shutter():
    sim = burst(4, n_frames=8)
    noise = np.random.default_rng(0).normal(0, 5, (2, *sim.frames.shape[1:]))
    frames = np.concatenate([sim.frames[:1] + noise, sim.frames[1:2] + noise[::-1]])
    result = deepir.run("nuc", frames=frames, threads=1)
    assert result.frames_used.all()
