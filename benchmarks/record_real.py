"""What can be said of a real burst, whose truth nobody knows, from a result that is stored."""

from __future__ import annotations

import functools
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import torch
from real import CROP, DATA, correlation, held_out_error

import deepir
from deepir.registration import register


def measured(folder: Path) -> dict[str, float]:
    """Of a run on the A65's frames but one: how far off that one is, and how alike frames are that have moved.

    The error is that of the bulk of the pixels, in counts; the likeness the correlation of the fine detail of the first
    frame and the last once they are corrected, where a sensor was found.
    """
    with np.load(folder / "result.npz") as stored:
        result = SimpleNamespace(scene=stored["scene"], gain=stored["gain"], offset=stored["offset"])
    frames, motion = a65()
    error = held_out_error(result, frames, motion)
    found = {"held_out_frame": float(1.4826 * np.median(np.abs(error - np.median(error))))}
    if np.ptp(result.gain) or np.ptp(result.offset):
        found["pattern_correlation"] = correlation((frames - result.offset) / result.gain)
    return found


@functools.cache
def a65() -> tuple[np.ndarray, torch.Tensor]:
    """Ten frames from a moving car, and their motion."""
    y0, y1, x0, x1 = CROP
    frames = deepir.read_frames(DATA / "a65" / "a65_frames_000-009.npz").frames[:, y0:y1, x0:x1]
    return frames, register(torch.from_numpy(frames), model="affine").motion
