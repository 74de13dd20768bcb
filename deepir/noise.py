"""How noisy are the samples? Estimates that need no model of the scene, for a start."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.thin import thinned

MAD = 1.4826  # standard deviation of a Gaussian per median absolute deviation


def sample_noise(frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of a sample's noise from frames (N, h, w); usable (N, h, w) bool.

    From differences of consecutive frames, in which a fixed pattern cancels, or from the one frame there is. The
    median of diagonal second differences leaves smooth parts and edges of the scene out; fine texture stays in, so
    that this is an upper bound.
    """
    if len(frames) > 1:
        frames, usable = (frames[1:] - frames[:-1]) / 2**0.5, usable[1:] & usable[:-1]
    detail = (frames[:, 1:, 1:] - frames[:, 1:, :-1] - frames[:, :-1, 1:] + frames[:, :-1, :-1]) / 2
    whole = usable[:, 1:, 1:] & usable[:, 1:, :-1] & usable[:, :-1, 1:] & usable[:, :-1, :-1]
    some, counts = thinned(detail[:, None], whole[:, None])
    found = some[counts].abs()
    return float(MAD * torch.median(found)) if found.numel() else 0.0


def typical_noise(precision: Tensor) -> float:
    """Median standard deviation of the samples (N, C, h, w) that count; NaN if none does."""
    (some,) = thinned(precision)
    return float(some[some > 0].median().rsqrt())
