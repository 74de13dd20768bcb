"""Integration of the scene over the detector's area."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
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
    """Mean over rectangles of `factor` px down and across, from the edge of a pixel; (N, C, P h, Q w) -> (N, C, h, w).

    One number stands for squares. A factor that is not whole, such as 1.5, weighs each pixel by the part of its area
    within a rectangle.

    Saragadam et al. 2021, supplement, "Details about super resolution".
    """

    example_shape = (2, 1, 6, 9)
    example_options: ClassVar = {"factor": 3}

    def __init__(self, *, factor: float | tuple[float, ...] = 2) -> None:
        super().__init__()
        given = factor if isinstance(factor, tuple | list) else (factor, factor)
        if len(given) != 2:
            raise ValueError(f"factor = {list(given)}: one number, or two (down and across), is needed")
        for each in given:
            if not 1 <= each <= MAX_FACTOR:
                raise ValueError(f"factor must be 1 to {MAX_FACTOR}, not {each:g}")
        self.exact = tuple(Fraction(each).limit_denominator(MAX_DENOMINATOR) for each in given)
        self.factor = tuple(int(each) if each.denominator == 1 else float(each) for each in self.exact)
        self.noise_gain = math.prod(self.factor) ** 0.5  # so many unknowns share the information of a sample

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Both sides divided by their factor; they must be multiples of it."""
        *head, height, width = x_shape
        sides = [side / factor for side, factor in zip((height, width), self.exact, strict=True)]
        if any(side.denominator > 1 for side in sides):
            raise ValueError(f"downsample: {height} x {width} is no multiple of the factor {in_words(self.factor)}")
        return (*head, *map(int, sides))

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """Both sides times their factor.

        Raises:
            ValueError: A side is not whole.
        """
        height, width = (side * factor for side, factor in zip(out_size, self.exact, strict=True))
        if height.denominator > 1 or width.denominator > 1:
            raise ValueError(
                f"downsample: {out_size[0]} x {out_size[1]} px times {in_words(self.factor)} are no whole pixels; "
                f"crop the frames to sides that are multiples of {in_words([each.denominator for each in self.exact])}"
            )
        return int(height), int(width)

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Average over the rectangles."""
        size, area = self.out_shape(x.shape, x.shape[0])[-2:], math.prod(self.factor)
        if self._whole:
            down, across = self.factor
            rows = functools.reduce(torch.add, x.unflatten(-2, (-1, down)).unbind(-2))  # half the time of `sum`
            return rows.unflatten(-1, (-1, across)).sum(-1) / area
        rows, columns = (_parts(*each).to(x) for each in zip(size, self.factor, strict=True))
        return rows @ x @ columns.mT / area

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Rectangles all of whose pixels are valid."""
        if self._whole:
            return -F.max_pool2d(-mask, tuple(map(int, self.factor)))
        size = self.out_shape(mask.shape, 1)[-2:]
        rows, columns = (_parts(*each).sign().to(mask) for each in zip(size, self.factor, strict=True))
        return (rows @ (1 - mask) @ columns.mT == 0).to(mask)

    @property
    def _whole(self) -> bool:
        return all(isinstance(each, int) for each in self.factor)


def _parts(side: int, factor: float) -> Tensor:
    """The part of each pixel within each rectangle along an axis, (side, side times the factor)."""
    edges = torch.arange(side + 1, dtype=torch.float64) * factor
    pixels = torch.arange(round(side * factor), dtype=torch.float64)
    first, last = edges[:-1, None], edges[1:, None]
    return (torch.minimum(last, pixels + 1) - torch.maximum(first, pixels)).clamp(0, 1)


def in_words(values: Sequence[float]) -> str:
    """Values down and across in words, once if they are equal."""
    return " x ".join(f"{each:g}" for each in dict.fromkeys(values))
