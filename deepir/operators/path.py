"""The way of the camera between the frames."""

from __future__ import annotations

import functools

import numpy as np
import torch
from scipy.interpolate import CubicSpline
from torch import Tensor

END = "not-a-knot"


def between(motion: Tensor, steps: int) -> Tensor:
    """Motions (N, ...) and, evenly between each two, `steps - 1` on the cubic spline through them."""
    if steps == 1 or len(motion) == 1:
        return motion
    weights = _weights(len(motion), steps).to(motion)
    return (weights @ motion.flatten(1)).unflatten(1, motion.shape[1:])


@functools.lru_cache(maxsize=16)
def _weights(count: int, steps: int) -> Tensor:
    """(instants, frames)."""
    at = np.arange((count - 1) * steps + 1) / steps
    return torch.from_numpy(CubicSpline(np.arange(count), np.eye(count), bc_type=END)(at))
