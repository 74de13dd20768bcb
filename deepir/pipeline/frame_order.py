"""Frames in the order of time, where each goes on from the one before it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir.errors import ConfigError
from deepir.io.selection import select_frames
from deepir.messages import Message

Mask = np.ndarray[Any, Any]
MAX_FRAMES = 10**6  # more frames than any burst has


def demand_order(select: str | int | Sequence[int] | None, problem: str) -> None:
    """Raise `ConfigError` if `data.frames` does not keep frames one after the other."""
    if isinstance(select, str | int | None) and ":" not in str(select):
        return
    chosen = select_frames(np.arange(MAX_FRAMES), select, "data")
    if (np.diff(chosen) != 1).any():
        raise ConfigError(
            f"data.frames={select!r}: '{problem}' needs frames that follow each other in time; give a count or a slice"
        )


def interpolate_missing_motion(motion: Tensor, used: Mask) -> tuple[Tensor, Mask]:
    """Motions (N, 3, 3) with gaps filled in, and which frames are taken, (N,): all from the first to the last used."""
    at, known = np.arange(len(used)), np.flatnonzero(used)
    entries = motion.flatten(1).numpy()
    filled = np.stack([np.interp(at, known, entry[known]) for entry in entries.T], 1)
    return torch.from_numpy(filled).view_as(motion), (at >= known[0]) & (at <= known[-1])


def interpolation_message(used: Mask, taken: Mask) -> list[str]:
    """A line for each frame that is taken without being used."""
    return [
        Message(
            "frame-interpolated",
            f"frame {k} is bridged: where the camera was then, on which the next frames depend, is interpolated",
        )
        for k in np.flatnonzero(taken & ~used)
    ]
