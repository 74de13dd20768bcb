"""A camera that moves during the exposure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.fields.psf.base import EDGE_WIDTH, PSF, pixel_average
from deepir.registry import register


@register("field", "motion_blur")
class MotionBlur(PSF):
    """The line that a straight, even motion makes of a point, (1, 1, 2 r + 1, 2 r + 1), sum one.

    `length` in px and `angle` in degrees, from +x towards +y, are free. It is integrated over pixels. The blur's
    radius should be a px more than half its length.
    """

    example_options: ClassVar = {"size": (60, 80), "length": 4.0, "angle": 30.0}
    search_ratio: ClassVar[float] = 1.25
    can_represent: ClassVar[bool] = False  # its direction, to half a degree

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        size: tuple[int, int],
        length: float = 3.0,
        angle: float = 0.0,
    ) -> None:
        super().__init__(shape, neutral, size, "length", length)
        if shape[0] > 1:
            raise ValueError("motion_blur has one direction for all frames; of a blur per frame take simplex")
        if not math.isfinite(angle):
            raise ValueError(f"angle must be a number of degrees, not {angle}")
        self.turn = nn.Parameter(torch.tensor(math.radians(angle) / self.preconditioning_scale))

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised line of a length."""
        angle = self.preconditioning_scale * self.turn

        def line(x: Tensor, y: Tensor) -> Tensor:
            along, across = x * angle.cos() + y * angle.sin(), y * angle.cos() - x * angle.sin()
            ends = ((width / 2 - along) / EDGE_WIDTH).sigmoid() - (
                (-width / 2 - along) / EDGE_WIDTH
            ).sigmoid()
            return ends * torch.exp(-((across / EDGE_WIDTH) ** 2) / 2)

        found = pixel_average(self._axis(), line)
        return (found / found.sum()).expand(self.shape)

    @torch.no_grad()
    def search_starts(self) -> Iterator[dict[str, Tensor]]:
        """Each width in eight directions."""
        for state in super().search_starts():
            for i in range(8):
                yield state | {"turn": self.turn.new_tensor(math.pi * i / 8 / self.preconditioning_scale)}

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over the direction in which `value` is widest, and the length that has its mean squared radius."""
        axis, kernel = self._axis(), value.to(self.value).expand(self.shape)[0, 0]
        x, y = axis, axis[:, None]
        xx, xy, yy = ((kernel * each).sum() for each in (x * x, x * y, y * y))
        self.turn.copy_(torch.atan2(2 * xy, xx - yy) / 2 / self.preconditioning_scale)
        super().init_from(value)
