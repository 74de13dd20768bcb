"""Trajectory of the camera between the frames."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Trajectory:
    """Instants at which an operator needs its input; by default those of the frames.

    Attributes:
        steps: Instants per frame after the first.
        n_before: Instants before the first frame.
    """

    steps: int = 1
    n_before: int = 0

    def count(self, n_frames: int) -> int:
        """Number of instants for a number of frames."""
        return self.n_before + (n_frames - 1) * self.steps + 1

    def frames(self, count: int) -> int:
        """Number of frames for a number of instants."""
        return (count - 1 - self.n_before) // self.steps + 1

    def interpolate(self, motion: Tensor) -> Tensor:
        """Motions at the instants, (instants, ...), on the cubic spline through those of the frames, (N, ...)."""
        if self == Trajectory():
            return motion
        weights = _weights(self, len(motion)).to(motion)
        return (weights @ motion.flatten(1)).unflatten(1, motion.shape[1:])


@functools.lru_cache(maxsize=16)
def _weights(path: Trajectory, n_frames: int) -> Tensor:
    """Interpolation weights, (instants, N)."""
    if n_frames == 1:
        return torch.ones(path.count(1), 1, dtype=torch.float64)
    from scipy.interpolate import CubicSpline  # most runs need none

    at = (np.arange(path.count(n_frames)) - path.n_before) / path.steps
    return torch.from_numpy(CubicSpline(np.arange(n_frames), np.eye(n_frames))(at))
