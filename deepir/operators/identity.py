"""The frames are the scene."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators.base import Operator
from deepir.registry import register


@register("operator", "identity")
class Identity(Operator):
    """`y = x`: what `physics: {}` stands for, plain denoising."""

    pointwise = keeps_grid = True

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """The input."""
        return x

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Two frames of 4 x 5 px."""
        generator = torch.Generator().manual_seed(0)
        return cls(), torch.rand(2, 1, 4, 5, generator=generator, dtype=torch.float64), {}
