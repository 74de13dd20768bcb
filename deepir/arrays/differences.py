"""Finite differences of images."""

from __future__ import annotations

from torch import Tensor


def squared_gradient(value: Tensor) -> Tensor:
    """`|∇x|²` by forward differences, (..., H, W); those across the lower and right edge are zero."""
    down = value.diff(dim=-2, append=value[..., -1:, :])
    right = value.diff(dim=-1, append=value[..., :, -1:])
    return down.square() + right.square()
