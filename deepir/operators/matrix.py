"""Any linear measurements of the scene."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "matrix")
class Matrix(Operator):
    """`y = matrix x`, with the scene as a vector, row after row: a single pixel, a coded aperture.

    The scene is `height` x `width` px, the slot `matrix` (1, 1, rows, height width), and the data (N, C, rows, 1).
    """

    example_shape = (2, 1, 4, 5)
    example_options: ClassVar = {"height": 4, "width": 5, "rows": 7}

    def __init__(self, *, height: int, width: int, rows: int) -> None:
        super().__init__()
        if min(height, width, rows) < 1:
            raise ValueError(f"height, width and rows must be at least 1, not {height}, {width}, {rows}")
        self.size, self.rows = (height, width), rows

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`matrix`: (1, 1, rows, height width)."""
        return {"matrix": (1, 1, self.rows, self.size[0] * self.size[1])}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, rows, 1)."""
        return (*x_shape[:2], self.rows, 1)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """The scene's, whatever the number of measurements."""
        return self.size

    def forward(self, x: Tensor, *, matrix: Tensor) -> Tensor:  # type: ignore[override]
        """The product."""
        return matrix.to(x.dtype) @ x.flatten(2)[..., None]

    def valid(self, mask: Tensor, *, matrix: Tensor) -> Tensor:  # type: ignore[override]
        """Measurements without a part in what is not valid."""
        return ((matrix != 0).to(mask.dtype) @ (1 - mask).flatten(2)[..., None] == 0).to(mask.dtype)
