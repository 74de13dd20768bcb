"""Base class of smoothed L1 norms of vectors."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.priors.penalties.base import SpatiallyWeighted


class SmoothedNorm(SpatiallyWeighted):
    """A sum of vector lengths, smoothed near zero for L-BFGS.

    Args:
        shape: Of the value; None without a weight map.
        weight: Fixed weight; None for `auto`.
        rounding: Smoothing length, in units of `1 / weight`.

    Raises:
        ValueError: `rounding` is not positive and finite.
    """

    #: Length that costs one nat at the default weight, noise standard deviations.
    scale: ClassVar[float]

    def __init__(
        self, shape: Shape | None = None, *, weight: float | None = None, rounding: float = 0.1
    ) -> None:
        super().__init__(shape, weight=weight)
        if not 0 < rounding < float("inf"):
            raise ValueError(f"rounding must be a positive number, not {rounding}")
        self.rounding = rounding

    @property
    def epsilon(self) -> Tensor:
        """Smoothing length e, units of the value."""
        return self.rounding / self.weight.clamp(min=1e-12)

    def default_weight(self, sigma: float) -> float:
        """One nat per `scale` noise standard deviations."""
        return 1 / (self.scale * sigma)

    def smoothed_l1(self, squared: Tensor) -> Tensor:
        """`Σ m (sqrt(|v|² + e²) - e)` with the weight map m, from `|v|²`; written without cancellation."""
        rounded = squared / (torch.sqrt(squared + self.epsilon.square()) + self.epsilon)
        return (self.weight_map * rounded).sum(dtype=torch.float64)
