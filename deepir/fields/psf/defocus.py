"""A point out of focus."""

from __future__ import annotations

from typing import ClassVar

from torch import Tensor

from deepir.fields.base import Shape
from deepir.fields.psf.base import EDGE_WIDTH, PSF, pixel_average
from deepir.registry import register


@register("field", "defocus")
class Defocus(PSF):
    """The disc that a lens out of focus makes of a point, (1, 1, 2 r + 1, 2 r + 1), sum one; `radius` in px is free.

    It has an edge, so that it is integrated over pixels. The blur's radius should be a px more than its own.
    """

    example_options: ClassVar = {"size": (60, 80), "radius": 2.2}

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], radius: float = 2.0
    ) -> None:
        super().__init__(shape, neutral, size, "radius", radius)

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised disc of a radius."""
        found = pixel_average(
            self._axis(), lambda x, y: ((width - (x**2 + y**2).sqrt()) / EDGE_WIDTH).sigmoid()
        )
        return (found / found.sum()).expand(self.shape)
