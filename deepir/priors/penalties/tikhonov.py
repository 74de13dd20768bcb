"""Smoothness."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.differences import squared_gradient
from deepir.priors.penalties.base import Penalty
from deepir.registry import register

#: Usual gradient, in standard deviations of the noise: edges are far above it. The best on the truth was 4 to 11, for a
#: burst and for one blurred frame.
GRADIENT_SIGMA_RATIO = 5.0


@register("penalty", "smooth")
class Tikhonov(Penalty):
    """Half the sum of squared gradients, `½ Σ |∇x|²`: shading, drift across the array (Tikhonov 1963)."""

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ |∇x|²`, with forward differences."""
        return squared_gradient(value).sum(dtype=torch.float64) / 2

    def default_weight(self, sigma: float) -> float:
        """A gradient of `GRADIENT_SIGMA_RATIO` standard deviations is usual."""
        return 1 / (GRADIENT_SIGMA_RATIO * sigma) ** 2

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight, of the gradient."""
        return 0.0, float(self.weight)
