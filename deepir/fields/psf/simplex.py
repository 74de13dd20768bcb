"""A point-spread function of any shape."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.fields.motion import PARAMETER_SCALE
from deepir.registry import register

#: Smallest initial value relative to the largest: exact zeros would remain zero.
MIN_INITIAL_RATIO = 1e-4


@register("field", "simplex")
class Simplex(Field):
    """Free values that are not negative and sum to one: a point-spread function of any shape.

    They are squares, scaled. It starts as a narrow Gaussian; from a file with `init`.
    """

    def __init__(self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int]) -> None:
        super().__init__(shape, neutral)
        self.preconditioning_scale = PARAMETER_SCALE / (size[0] * size[1]) ** 0.5
        self.values = nn.Parameter(torch.zeros(self.shape))
        y, x = (torch.arange(side) - side // 2 for side in self.shape[-2:])
        self.init_from(torch.exp(-(x**2 + y[:, None] ** 2) / 2.0))

    def forward(self) -> Tensor:
        """`values² / Σ values²`."""
        squares = self.values.square()
        return squares / squares.sum()

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over what is not negative, scaled to sum one."""
        value = value.to(self.values).expand(self.shape).clamp(min=0)
        value = value.clamp(min=MIN_INITIAL_RATIO * float(value.max()))
        self.values.copy_((value / value.sum()).sqrt() / self.preconditioning_scale)

    @classmethod
    def example(cls) -> Simplex:
        """A kernel of 5 x 5 px."""
        return cls((1, 1, 5, 5), size=(60, 80))
