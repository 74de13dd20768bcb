"""An unknown as free values on a grid."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.registry import register


@register("field", "pixels")
class Pixels(Field):
    """One free value for each element: the scene's pixels, or the level of each frame."""

    center: Tensor
    scale: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0) -> None:
        super().__init__(shape, neutral)
        self.values = nn.Parameter(torch.zeros(self.shape))
        self.register_buffer("center", torch.tensor(float(neutral)))
        self.register_buffer("scale", torch.tensor(1.0))

    def forward(self) -> Tensor:
        """`center + scale * values`."""
        return self.center + self.scale * self.values

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the value over; its mean and deviation become centre and scale."""
        value = value.to(self.values).expand(self.shape)
        deviation = value.std() if value.numel() > 1 else value.new_zeros(())
        self.center.copy_(value.mean())
        self.scale.copy_(torch.where(deviation > 0, deviation, torch.ones_like(deviation)))
        self.values.copy_((value - self.center) / self.scale)
