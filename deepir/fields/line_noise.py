"""Temporal row and column noise."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import GaussianField, Shape
from deepir.registry import register


class LineNoise(GaussianField):
    """Independent Gaussian value of each line of each frame; one zero per frame if `sigma` is zero.

    The temporal row and column components of the 3-D noise model.

    Args:
        shape: (N, 1, 1, 1).
        neutral: Value that leaves the data unchanged.
        size: (h, w) of a frame.
        sigma: Standard deviation, data units; estimated if None.

    Source: D'Agostino and Webb 1991, "Three-dimensional analysis framework for infrared imaging system noise".
    """

    example_shape = (3, 1, 1, 1)
    example_options: ClassVar = {"size": (4, 5), "sigma": 0.5}
    #: Axis across the lines: -2 for rows, -1 for columns.
    line_axis: ClassVar[int]
    #: Name of the lines in messages.
    line_name: ClassVar[str]
    newly_detected = False  # whether the last estimate was the first with a positive variance

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], sigma: float | None = None
    ) -> None:
        lines = [1, 1]
        lines[self.line_axis] = size[self.line_axis]
        super().__init__((*shape[:2], *lines), neutral, sigma=sigma)
        self.values = nn.Parameter(torch.zeros(self.shape))

    @property
    def constant_axes(self) -> tuple[int, ...]:
        """Axis along which the noise is constant."""
        return (-3 - self.line_axis,)

    @property
    def frame_mean_variance(self) -> float:
        """Variance of the mean of a frame, squared data units."""
        return float(self.sigma) ** 2 / self.shape[self.line_axis]

    def forward(self) -> Tensor:
        """(N, 1, h, 1) or (N, 1, 1, w); (N, 1, 1, 1) without strength."""
        if not self.sigma > 0:
            return self.values.new_full((len(self.values), 1, 1, 1), self.neutral)
        return self.neutral + self.preconditioning_scale * self.values

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent the mean along each line."""
        value = (value.to(self.values) - self.neutral).mean(-3 - self.line_axis, keepdim=True)
        self.values.copy_(value / self.preconditioning_scale)

    def curvature(self, precision: float) -> float:
        """Curvature of the objective in each parameter, for frames of this total precision."""
        return float(self.preconditioning_scale) ** 2 * (
            precision / self.shape[self.line_axis] + float(self.sigma) ** -2
        )


@register("field", "row_noise")
class RowNoise(LineNoise):
    """Temporal noise of each row: a microbolometer array is read row by row."""

    line_axis, line_name = -2, "rows"


@register("field", "column_noise")
class ColumnNoise(LineNoise):
    """Temporal noise of each column."""

    line_axis, line_name = -1, "columns"
