"""A field that is added on the way, such as stray flux."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "add")
class Add(Operator):
    """`y = x + value`; the slot `value` is (1, C, h, w). Before the sensor it is stray flux (narcissus)."""

    linear = False
    pointwise = keeps_grid = True
    neutral: ClassVar = {"value": 0.0}
    example_shape = (2, 1, 4, 5)

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`value`: (1, C, h, w)."""
        return {"value": (1, *x_shape[1:])}

    def forward(self, x: Tensor, *, value: Tensor) -> Tensor:  # type: ignore[override]
        """Add the field to each frame."""
        return x + value
