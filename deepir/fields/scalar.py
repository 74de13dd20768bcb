"""An unknown that is one number."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.registry import register


@register("field", "uniform")
class Scalar(Field):
    """One number for all elements, such as a time constant that all pixels share."""

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__(shape, neutral)
        self.value = nn.Parameter(torch.tensor(float(neutral)))

    def forward(self) -> Tensor:
        """The number, expanded."""
        return self.value.expand(self.shape)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """The mean."""
        self.value.copy_(value.to(self.value).mean())
