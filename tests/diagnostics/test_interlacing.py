"""Interlaced frames: every second row is of another time."""

import dataclasses

import numpy as np
import pytest
import torch

import deepir
from deepir.diagnostics.frames import are_interlaced
from deepir.registration import register
from deepir.simulate import Settings, simulate

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
