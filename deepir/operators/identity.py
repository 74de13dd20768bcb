"""The frames are the scene."""

from __future__ import annotations

from torch import Tensor

from deepir.operators.base import Operator
from deepir.registry import register


@register("operator", "identity")
class Identity(Operator):
    """`y = x`: what `physics: {}` stands for, plain denoising."""

    pointwise = keeps_grid = True
    example_shape = (2, 1, 4, 5)

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """The input."""
        return x
