"""The interface of penalties, and their spatial weights."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape


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


class SpatiallyWeighted(Penalty):
    """A penalty that is a sum over pixels, each weighted by `weight_map`, (H, W), ones at first; () without a shape."""

    adapts: ClassVar[bool] = True  # whether the weight map may be adapted to the scene
    weight_map: Tensor

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None) -> None:
        super().__init__(weight=weight)
        self.register_buffer("weight_map", torch.ones(shape[-2:] if shape else ()))

    @property
    def is_adaptive(self) -> bool:
        """Whether the weight map is estimated: a shape, and an automatic weight."""
        return self.user_weight is None and self.weight_map.ndim > 0

    @torch.no_grad()
    def inherit_weights(self, other: SpatiallyWeighted) -> None:
        """Copy the weight map of another penalty on the same value, if both adapt."""
        if self.is_adaptive and self.adapts and other.adapts:
            self.weight_map.copy_(other.weight_map)

    def typical_weight(self) -> float:
        """Geometric mean of the weights of all pixels."""
        return float(self.weight * self.weight_map.log().mean().exp())
