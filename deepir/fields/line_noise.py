"""Noise that all pixels of a row, or of a column, of one frame have in common."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.fields.gaussian_field import GaussianField
from deepir.registry import register


class LineNoise(GaussianField):
    """One Gaussian value for each line of each frame; `sigma`, in data units, is found from the burst if not given.

    Of the seven components of the 3-D noise model (D'Agostino and Webb 1991) those that are temporal and of lines.
    Without strength there is none, and its value has one element for each frame.
    """

    #: The axis that the lines lie beside each other on.
    line_axis: ClassVar[int]
    #: What they are called.
    line_name: ClassVar[str]
    #: Whether the last estimate was the first to find a variance.
    newly_detected = False

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], sigma: float | None = None
    ) -> None:
        lines = [1, 1]
        lines[self.line_axis] = size[self.line_axis]
        super().__init__((*shape[:2], *lines), neutral, sigma=sigma)
        self.values = nn.Parameter(torch.zeros(self.shape))

    @property
    def constant_axes(self) -> tuple[int, ...]:
        """The axes along which it is constant."""
        return (-3 - self.line_axis,)

    @property
    def frame_mean_variance(self) -> float:
        """Variance of the mean of a frame's values."""
        return float(self.sigma) ** 2 / self.shape[self.line_axis]

    def forward(self) -> Tensor:
        """(N, 1, h, 1) or (N, 1, 1, w); (N, 1, 1, 1) without strength."""
        if not self.sigma > 0:
            return self.values.new_full((len(self.values), 1, 1, 1), self.neutral)
        return self.neutral + self.preconditioning_scale * self.values

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the mean along the lines over."""
        value = (value.to(self.values) - self.neutral).mean(-3 - self.line_axis, keepdim=True)
        self.values.copy_(value / self.preconditioning_scale)

    def penalty(self) -> Tensor | None:
        """`½ Σ value² / sigma²`."""
        if not self.sigma > 0:
            return None
        return (self.preconditioning_scale / self.sigma * self.values).square().sum() / 2

    def curvature(self, precision: float) -> float:
        """Of the objective along each parameter, for frames of so much precision in all."""
        return float(self.preconditioning_scale) ** 2 * (
            precision / self.shape[self.line_axis] + float(self.sigma) ** -2
        )

    @classmethod
    def example(cls) -> LineNoise:
        """Three frames of 4 x 5 px."""
        return cls((3, 1, 1, 1), size=(4, 5), sigma=0.5)


@register("field", "row_noise")
class RowNoise(LineNoise):
    """What each row of each frame jumps by: a microbolometer array is read row by row."""

    line_axis, line_name = -2, "rows"


@register("field", "column_noise")
class ColumnNoise(LineNoise):
    """What each column of each frame jumps by."""

    line_axis, line_name = -1, "columns"
