"""Smoothness."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.penalties.penalty import Penalty, squared_gradient
from deepir.registry import register


@register("penalty", "smooth")
class Smooth(Penalty):
    """Half the sum of squared gradients, `½ Σ |∇x|²`: shading, drift across the array (Tikhonov 1963)."""

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ |∇x|²`, with forward differences."""
        return squared_gradient(value).sum(dtype=torch.float64) / 2

    def natural(self, noise: float) -> float:
        """One nat for a pixel whose gradient is `sqrt(2)` standard deviations."""
        return 1 / noise**2
