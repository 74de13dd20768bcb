"""Closeness to a value, with few exceptions."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.priors.penalties.base import Penalty
from deepir.registry import register


@register("penalty", "l1")
class L1(Penalty):
    """The distance from `center`, `Σ |x - center|`: a Laplacian of scale `1 / weight`."""

    def __init__(self, *, weight: float | None = None, center: float = 0.0) -> None:
        super().__init__(weight=weight)
        self.center = center

    def energy(self, value: Tensor) -> Tensor:
        """`Σ |x - center|`."""
        return (value - self.center).abs().sum(dtype=torch.float64)
