"""Integration of the scene over the detector's area."""

from __future__ import annotations

from fractions import Fraction
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register

MAX_FACTOR = 8  # largest factor: beyond, the pixel's aperture removes all finer detail
MAX_DENOMINATOR = 16  # largest denominator of a factor that is not whole


@register("operator", "downsample")
class Downsample(Operator):
    """Mean over squares of `factor` x `factor` px aligned on pixel edges; (N, C, Q h, Q w) -> (N, C, h, w).

    A factor that is not whole, such as 1.5, weighs each pixel by the part of its area within a square.

    Saragadam et al. 2021, supplement, "Details about super resolution".
    """

    example_shape = (2, 1, 6, 9)
    example_options: ClassVar = {"factor": 3}

    def __init__(self, *, factor: float = 2) -> None:
        super().__init__()
        if not 1 <= factor <= MAX_FACTOR:
            raise ValueError(f"factor must be 1 to {MAX_FACTOR}, not {factor:g}")
        self.exact = Fraction(factor).limit_denominator(MAX_DENOMINATOR)
        self.factor = int(self.exact) if self.exact.denominator == 1 else float(self.exact)
        self.noise_gain = float(factor)  # the information of a sample is shared by factor² unknowns

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Both sides divided by `factor`; they must be multiples of it."""
        *head, height, width = x_shape
        if (height / self.exact).denominator > 1 or (width / self.exact).denominator > 1:
            raise ValueError(f"downsample: {height} x {width} is no multiple of the factor {self.factor}")
        return (*head, int(height / self.exact), int(width / self.exact))

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """Both sides times `factor`.

        Raises:
            ValueError: A side is not whole.
        """
        height, width = (side * self.exact for side in out_size)
        if height.denominator > 1 or width.denominator > 1:
            raise ValueError(
                f"downsample: {out_size[0]} x {out_size[1]} px times {self.factor} are no whole pixels; "
                f"crop the frames to sides that are multiples of {self.exact.denominator}"
            )
        return int(height), int(width)

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Average over the squares."""
        height, width = self.out_shape(x.shape, x.shape[0])[-2:]
        if isinstance(self.factor, int):
            sums = x.unflatten(-2, (-1, self.factor)).sum(-2).unflatten(-1, (-1, self.factor)).sum(-1)
            return sums / self.factor**2  # an axis at a time: both at once take twice as long
        down, across = (self._parts(side).to(x) for side in (height, width))
        return down @ x @ across.mT / self.factor**2

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Squares all of whose pixels are valid."""
        if isinstance(self.factor, int):
            return -F.max_pool2d(-mask, self.factor)
        down, across = (self._parts(side).sign().to(mask) for side in self.out_shape(mask.shape, 1)[-2:])
        return (down @ (1 - mask) @ across.mT == 0).to(mask)

    def _parts(self, side: int) -> Tensor:
        """The part of each pixel within each square along an axis, (side, side times the factor)."""
        edges = torch.arange(side + 1, dtype=torch.float64) * self.factor
        pixels = torch.arange(round(side * self.factor), dtype=torch.float64)
        first, last = edges[:-1, None], edges[1:, None]
        return (torch.minimum(last, pixels + 1) - torch.maximum(first, pixels)).clamp(0, 1)
