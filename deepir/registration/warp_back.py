"""Frames on the grid of the first."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.registration.pyramid import Level, sample


@dataclass(frozen=True)
class WarpedFrames:
    """Frames `(N, h, w)` on the grid of the first, where they are known, and over the frames the sums of both."""

    frames: Tensor
    known: Tensor
    total: Tensor
    count: Tensor

    @property
    def mean(self) -> Tensor:
        """The scene `(h, w)`."""
        return self.total / self.count.clamp_min(1)

    def leave_one_out_mean(self) -> tuple[Tensor, Tensor]:
        """For each frame the mean of all others, and where both are known."""
        count = self.count - self.known
        return (self.total - self.frames) / count.clamp_min(1), self.known * (count > 0.5)

    def subsampled(self, stride: int) -> WarpedFrames:
        """Every `stride`-th pixel along each axis."""
        strided = slice(None, None, stride)
        images = (self.frames, self.known, self.total, self.count)
        return WarpedFrames(*(each[..., strided, strided] for each in images))


def warp_to_reference(level: Level, pattern: Tensor, motion: Tensor) -> WarpedFrames:
    """Frames less the pattern, pulled back."""
    frames, known = sample(level.frames - pattern, torch.linalg.inv(motion), level)
    return WarpedFrames(frames, known, frames.sum(0), known.sum(0))
