"""Samples that are measured, of all that there are."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "mask")
class Mask(Operator):
    """`y = keep x`: a coded aperture, a mosaic, lost samples; the slot `keep` is (N, C, h, w), from 0 to 1.

    Samples of `keep` zero are not valid.
    """

    pointwise = keeps_grid = True
    neutral: ClassVar = {"keep": 1.0}

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`keep`: (N, C, h, w)."""
        return {"keep": (n_frames, *x_shape[1:])}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """One frame for each mask."""
        return (n_frames, *x_shape[1:])

    def forward(self, x: Tensor, *, keep: Tensor) -> Tensor:  # type: ignore[override]
        """The samples that are kept, and zeros."""
        return keep * x

    def valid(self, mask: Tensor, *, keep: Tensor) -> Tensor:  # type: ignore[override]
        """Valid samples that are kept."""
        return mask * (keep != 0)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three masks of one picture, with samples that are lost."""
        operator, x, slots = super().example()
        return operator, x, {"keep": slots["keep"] * (slots["keep"] > 0.4)}
