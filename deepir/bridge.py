"""Frames that cannot be used, but may not be missing either, where each goes on from the one before it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

Mask = np.ndarray[Any, Any]


def bridged(motion: Tensor, used: Mask) -> tuple[Tensor, Mask]:
    """Motions (N, 3, 3) with those in between filled in, and which frames are taken, (N,): from first to last used."""
    at, known = np.arange(len(used)), np.flatnonzero(used)
    taken = (at >= known[0]) & (at <= known[-1])
    entries = motion.flatten(1).numpy()
    filled = np.stack([np.interp(at, known, entry[known]) for entry in entries.T], 1)
    return torch.from_numpy(filled).view_as(motion), taken


def bridge_message(used: Mask, taken: Mask) -> list[str]:
    """A line that names the frames that are bridged."""
    names = ", ".join(str(k) for k in np.flatnonzero(taken & ~used))
    if not names:
        return []
    return [f"frame {names} is bridged: the frames after it depend on where the camera was, which is interpolated"]
