"""Base class of penalties."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
from torch import Tensor, nn


class Penalty(nn.Module):
    """Negative log-prior of an unknown, `weight * energy(value)`, nats.

    Attributes:
        weight: Nats per unit of the energy.
        user_weight: Weight of the configuration; None for `auto`: a problem sets it, mostly to `default_weight`.

    Args:
        weight: Fixed weight; None for `auto`.

    Raises:
        ValueError: The weight is negative or not finite.
    """

    weight: Tensor
    #: Whether it acts on samples at pixel centres instead of spline coefficients; see `Operator.to_pixels`.
    acts_on_pixels: ClassVar[bool] = False
    #: log2 smoothness of the scene above which the default weight grows; inf: never.
    smooth_scene_threshold: ClassVar[float] = math.inf
    #: Whether noise alone determines its weight, whatever cross-validation finds for another penalty.
    weighed_by_noise: bool = False

    def __init__(self, *, weight: float | None = None) -> None:
        super().__init__()
        if weight is not None and not 0 <= weight < float("inf"):
            raise ValueError(f"weight must be a number of at least 0, not {weight}")
        self.user_weight = weight
        self.register_buffer("weight", torch.tensor(1.0 if weight is None else float(weight)))

    def forward(self, value: Tensor) -> Tensor:
        """`weight * energy(value)`, a scalar."""
        return self.weight * self.energy(value)

    def energy(self, value: Tensor) -> Tensor:
        """Energy of a value (..., H, W): a scalar, in units of the value or their square."""
        raise NotImplementedError

    def default_weight(self, sigma: float) -> float:
        """Weight for a value whose unregularised estimate has noise of standard deviation `sigma`."""
        return 1.0

    def typical_weight(self) -> float:
        """Weight at a typical pixel."""
        return float(self.weight)

    def adapt(self, value: Tensor, noise: float) -> None:
        """Update buffers from the present value; called between the stages of a solve.

        Args:
            value: (..., H, W).
            noise: Standard deviation of its noise.
        """

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """Mean curvature at `value` as coefficients (identity, negative Laplacian), weight included."""
        return 0.0, 0.0

    def fraction_shrunk_to_zero(self, value: Tensor) -> float:
        """Fraction of the value that the penalty has flattened; NaN if unknown."""
        return math.nan

    @classmethod
    def example(cls, **options: Any) -> Penalty:
        """One for a value of 7 x 9 px: the test-suite collects it from the registry."""
        return cls(**options)
