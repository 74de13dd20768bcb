"""Exponential decay, as of a plate that cools after a flash."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "decay")
class Decay(Operator):
    """`y_k = x exp(-rate t_k)`: pulsed thermography, fluorescence; the slot `rate` is (1, C, h, w).

    The frames are taken at the times `t`, one each, in units of 1 / `rate`.
    """

    times: Tensor
    pointwise = keeps_grid = True
    neutral: ClassVar = {"rate": 0.0}
    example_options: ClassVar = {"t": (0.0, 1.0, 2.5)}

    def __init__(self, *, t: Sequence[float] = (0.0,)) -> None:
        super().__init__()
        self.register_buffer("times", torch.tensor(list(t), dtype=torch.float64).reshape(-1, 1, 1, 1))

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`rate`: (1, C, h, w)."""
        return {"rate": (1, *x_shape[1:])}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """One frame for each time."""
        return (len(self.times), *x_shape[1:])

    def forward(self, x: Tensor, *, rate: Tensor) -> Tensor:  # type: ignore[override]
        """The scene at each time."""
        return x * torch.exp(-rate * self.times.to(x))
