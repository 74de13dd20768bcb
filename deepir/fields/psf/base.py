"""Point-spread functions with one width."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.fields.motion import PARAMETER_SCALE

#: Largest width, px.
MAX_WIDTH = 1e2
#: Smallest width of a search, px: narrower kernels are indistinguishable.
MIN_WIDTH = 0.4
#: Quadrature points along the side of a pixel.
POINTS_PER_PIXEL = 8
#: Width of the soft edge of a kernel, px.
EDGE_WIDTH = 0.2


class PSF(Field):
    """A point-spread function (1, 1, 2 r + 1, 2 r + 1) of sum one; its width in px is free, and positive.

    A subclass gives the kernel for a width. It is that of the optics: the pixels' own area is `downsample`'s.
    """

    #: Ratio of successive initial widths of a search; small where the spectrum has zeros.
    search_ratio: ClassVar[float] = 1.1

    def __init__(self, shape: Shape, neutral: float, size: tuple[int, int], name: str, width: float) -> None:
        super().__init__(shape, neutral)
        if not 0 < width < math.inf:
            raise ValueError(f"{name} must be a positive number of px, not {width}")
        self.preconditioning_scale = PARAMETER_SCALE / math.sqrt(size[0] * size[1])
        self.value = nn.Parameter(torch.tensor(math.log(width) / self.preconditioning_scale))

    @property
    def width(self) -> Tensor:
        """The width in px, a scalar."""
        return (self.preconditioning_scale * self.value).exp()

    def forward(self) -> Tensor:
        """The normalised kernel."""
        return self.kernel_of_width(self.width)

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised kernel of a width."""
        raise NotImplementedError

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over the width: the kernel with the mean squared radius of `value`, by bisection."""
        target = self._mean_squared_radius(value.to(self.value))
        low, high = (self.value.new_tensor(bound) for bound in (1 / MAX_WIDTH, MAX_WIDTH))
        for _ in range(60):
            middle = (low * high).sqrt()
            narrow = self._mean_squared_radius(self.kernel_of_width(middle)) < target
            low, high = torch.where(narrow, middle, low), torch.where(narrow, high, middle)
        self.value.copy_((low * high).sqrt().log() / self.preconditioning_scale)

    @torch.no_grad()
    def search_starts(self) -> Iterator[dict[str, Tensor]]:
        """States from which a search for the parameters may begin: widths up to the radius."""
        count = math.ceil(math.log(self.shape[-1] / MIN_WIDTH) / math.log(self.search_ratio))
        widths = [MIN_WIDTH * self.search_ratio**i for i in range(count + 1)]
        for width in widths:
            yield self.state_dict() | {
                "value": self.value.new_tensor(math.log(width) / self.preconditioning_scale)
            }

    def _axis(self) -> Tensor:
        radius = self.shape[-1] // 2
        return torch.arange(-radius, radius + 1, dtype=self.value.dtype, device=self.value.device)

    def _mean_squared_radius(self, kernel: Tensor) -> Tensor:
        squares = self._axis().square()
        return (kernel * (squares[:, None] + squares)).sum() / kernel.sum()


def pixel_average(axis: Tensor, function: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """The mean of a function of (x, y) over the area of each pixel at `axis`, (n, n)."""
    inside = (
        torch.arange(POINTS_PER_PIXEL, dtype=axis.dtype, device=axis.device) + 0.5
    ) / POINTS_PER_PIXEL - 0.5
    fine = (axis[:, None] + inside).flatten()
    return F.avg_pool2d(function(fine, fine[:, None])[None, None], POINTS_PER_PIXEL)[0, 0]
