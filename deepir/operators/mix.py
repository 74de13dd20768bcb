"""Frames that weigh a scene: integration times, and two scenes in one picture."""

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


@register("operator", "mix")
class Mix(Operator):
    """`y_k = a_k x + b_k s`: a filter wheel, a polariser, a reflection.

    The slot `s`, (1, C, h, w), is another scene; `a` and `b`, (N, 1, 1, 1), are the weights of the two in each frame.
    """

    linear = False
    pointwise = keeps_grid = True
    neutral: ClassVar = {"a": 1.0, "b": 1.0, "s": 0.0}

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`a` and `b`: (N, 1, 1, 1); `s`: (1, C, h, w)."""
        weight = (n_frames, 1, 1, 1)
        return {"a": weight, "b": weight, "s": (1, *x_shape[1:])}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """One frame for each pair of weights."""
        return (n_frames, *x_shape[1:])

    def forward(self, x: Tensor, *, a: Tensor, b: Tensor, s: Tensor) -> Tensor:  # type: ignore[override]
        """The weighted sum of the two scenes."""
        return a * x + b * s
