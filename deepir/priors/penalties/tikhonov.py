"""Smoothness."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.windows import squared_gradient
from deepir.priors.penalties.base import Penalty
from deepir.registry import register

#: Typical gradient, noise standard deviations; 4 to 11 were best on bursts and a blurred frame with known truth.
GRADIENT_SIGMA_RATIO = 5.0


@register("penalty", "smooth")
class Tikhonov(Penalty):
    """Half the sum of squared gradients, `½ Σ |∇x|²`: shading, drift across the array (Tikhonov 1963)."""

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ |∇x|²`, with forward differences."""
        return squared_gradient(value).sum(dtype=torch.float64) / 2

    def default_weight(self, sigma: float) -> float:
        """Inverse variance of a gradient of `GRADIENT_SIGMA_RATIO` noise standard deviations."""
        return 1 / (GRADIENT_SIGMA_RATIO * sigma) ** 2

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight, of the gradient."""
        return 0.0, float(self.weight)
