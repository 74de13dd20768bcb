"""A few of a burst's samples: enough for a median or a mean."""

from __future__ import annotations

import math

import torch
from torch import Tensor

ENOUGH = 40_000  # samples of each frame


def subsample(*frames: Tensor, enough: int = ENOUGH) -> list[Tensor]:
    """The same samples of each of the `frames` (N, C, h, w), as (N, m): all, or about `enough`, from all columns."""
    *_, height, width = frames[0].shape
    step = max(1, height * width // enough)
    while math.gcd(step, width) > 1:  # it would meet the same columns again and again
        step += 1
    return [each.flatten(1)[:, ::step] for each in frames]


def masked_values(values: Tensor, counts: Tensor) -> Tensor:
    """Those of the values that count, (K,): by numpy, where torch takes ten times as long."""
    if values.device.type != "cpu":
        return values[counts]
    return torch.from_numpy(values.numpy()[counts.numpy()])
