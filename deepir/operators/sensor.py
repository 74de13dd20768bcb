"""The microbolometer array."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "sensor")
class Sensor(Operator):
    """Gain, offset and levels of frames or of their lines: `y_k = gain * x_k + offset + level_k`, (N, 1, h, w).

    `reference`, in the data's units, is the level at which the estimates of gain and offset are taken to be independent
    of each other: 0 for a raw detector; None: as the data have it.

    Saragadam et al. 2021, the equation that ends "Sensor modeling"; it leaves the drift out.
    """

    linear = False
    pointwise = keeps_grid = True
    neutral: ClassVar = {"gain": 1.0, "offset": 0.0, "level": 0.0}
    example_shape = (3, 1, 4, 5)

    def __init__(self, reference: float | None = None) -> None:
        """`reference`: see above.

        Raises:
            ValueError: It is not finite.
        """
        super().__init__()
        if reference is not None and not math.isfinite(reference):
            raise ValueError(f"reference = {reference}: a level in the data's units is needed, or auto")
        self.reference = reference

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`gain`, `offset`: (1, C, h, w); `level`: (N, 1, 1, 1), or what fits."""
        maps = (1, *x_shape[1:])
        return {"gain": maps, "offset": maps, "level": (n_frames, 1, 1, 1)}

    def fits(self, slot: str, wanted: Shape, found: Shape) -> bool:
        """A level may differ from row to row, and from column to column."""
        return found == wanted or (slot == "level" and found[:2] == wanted[:2] and len(found) == 4)

    def forward(self, x: Tensor, *, gain: Tensor, offset: Tensor, level: Tensor) -> Tensor:  # type: ignore[override]
        """Apply the sensor to the flux on each pixel."""
        return torch.addcmul(offset, gain, x) + level

    @torch.no_grad()
    def adjoint(self, y: Tensor, x_shape: Shape, *, gain: Tensor, **_: Tensor) -> Tensor:  # type: ignore[override]
        """Of the linear part, the gain."""
        return (gain * y).sum_to_size(x_shape)
