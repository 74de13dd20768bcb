"""Base class of penalties with a weight map."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.priors.penalties.base import Penalty


class SpatiallyWeighted(Penalty):
    """A penalty that is a sum over pixels, each weighted by `weight_map`, (H, W), ones at first; () without a shape."""

    #: Whether the weight map may be adapted to the scene.
    adapts: ClassVar[bool] = True
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
