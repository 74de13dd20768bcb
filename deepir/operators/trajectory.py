"""The way of the camera between the frames."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


@dataclass(frozen=True)
class Trajectory:
    """Instants at which an operator wants its input: `steps` for each frame after the first, and `lead` before it.

    One for each frame unless said otherwise.
    """

    steps: int = 1
    n_before: int = 0

    def count(self, n_frames: int) -> int:
        """How many instants there are."""
        return self.n_before + (n_frames - 1) * self.steps + 1

    def frames(self, count: int) -> int:
        """The inverse of `count`."""
        return (count - 1 - self.n_before) // self.steps + 1

    def interpolate(self, motion: Tensor) -> Tensor:
        """Motions (N, ...) -> (instants, ...): on the cubic spline through them, which goes on before the first."""
        if self == Trajectory():
            return motion
        weights = _weights(self, len(motion)).to(motion)
        return (weights @ motion.flatten(1)).unflatten(1, motion.shape[1:])


@functools.lru_cache(maxsize=16)
def _weights(path: Trajectory, n_frames: int) -> Tensor:
    """Of each frame at each instant, (instants, N)."""
    if n_frames == 1:
        return torch.ones(path.count(1), 1, dtype=torch.float64)
    from scipy.interpolate import CubicSpline  # most runs need none

    at = (np.arange(path.count(n_frames)) - path.n_before) / path.steps
    return torch.from_numpy(CubicSpline(np.arange(n_frames), np.eye(n_frames))(at))
