"""Closeness to a value."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.priors.penalties.base import Penalty
from deepir.registry import register


class Distance(Penalty):
    """How far a value is from `center`."""

    def __init__(self, *, weight: float | None = None, center: float = 0.0) -> None:
        super().__init__(weight=weight)
        self.center = center


@register("penalty", "l1")
class L1(Distance):
    """The distance from `center`, `Σ |x - center|`: a Laplacian of scale `1 / weight`."""

    def energy(self, value: Tensor) -> Tensor:
        """`Σ |x - center|`."""
        return (value - self.center).abs().sum(dtype=torch.float64)


@register("penalty", "ridge")
class Ridge(Distance):
    """Half the squared distance from `center`, `½ Σ (x - center)²`: a Gaussian of variance `1 / weight`."""

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ (x - center)²`."""
        return (value - self.center).square().sum(dtype=torch.float64) / 2

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight."""
        return float(self.weight), 0.0
