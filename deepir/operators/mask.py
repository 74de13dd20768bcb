"""Samples that are measured, of all that there are."""

from __future__ import annotations

from typing import ClassVar

import torch
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
        """Two masks of one picture of 4 x 5 px."""
        generator = torch.Generator().manual_seed(0)
        x = torch.rand(1, 1, 4, 5, generator=generator, dtype=torch.float64)
        keep = torch.rand(2, 1, 4, 5, generator=generator, dtype=torch.float64)
        return cls(), x, {"keep": keep * (keep > 0.4)}
