"""Integration times."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "exposure")
class Exposure(Operator):
    """`y_k = time_k x`: frames of several integration times; the slot `time` is (N, 1, 1, 1)."""

    pointwise = keeps_grid = True
    neutral: ClassVar = {"time": 1.0}

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`time`: (N, 1, 1, 1)."""
        return {"time": (n_frames, 1, 1, 1)}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """One frame for each time."""
        return (n_frames, *x_shape[1:])

    def forward(self, x: Tensor, *, time: Tensor) -> Tensor:  # type: ignore[override]
        """The flux over each time."""
        return time * x
