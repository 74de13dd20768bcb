"""Finite differences of images."""

from __future__ import annotations

from torch import Tensor


def squared_gradient(value: Tensor) -> Tensor:
    """Squared gradient `|∇x|²` by forward differences; zero across the lower and right border.

    Args:
        value: (..., H, W).

    Returns:
        The squared gradient, same shape.
    """
    down = value.diff(dim=-2, append=value[..., -1:, :])
    right = value.diff(dim=-1, append=value[..., :, -1:])
    return down.square() + right.square()
