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

WIDEST = 1e2  # px
NARROW = 0.4  # px: less than that is not seen
FINE = 8  # points along a pixel's side


class PSF(Field):
    """A point-spread function (1, 1, 2 r + 1, 2 r + 1) of sum one; its width in px is free, and positive.

    A subclass gives the kernel for a width. It is that of the optics: the pixels' own area is `downsample`'s.
    """

    #: Of the widths from which a search begins; where the spectrum has zeros, they are to be met.
    ratio: ClassVar[float] = 1.1

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
        return self.of_width(self.width)

    def of_width(self, width: Tensor) -> Tensor:
        """The normalised kernel of a width."""
        raise NotImplementedError

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over the width: the kernel with the mean squared radius of `value`, by bisection."""
        target = self._spread(value.to(self.value))
        low, high = (self.value.new_tensor(bound) for bound in (1 / WIDEST, WIDEST))
        for _ in range(60):
            middle = (low * high).sqrt()
            narrow = self._spread(self.of_width(middle)) < target
            low, high = torch.where(narrow, middle, low), torch.where(narrow, high, middle)
        self.value.copy_((low * high).sqrt().log() / self.preconditioning_scale)

    @torch.no_grad()
    def starts(self) -> Iterator[dict[str, Tensor]]:
        """States from which a search for the parameters may begin: widths up to the radius."""
        count = math.ceil(math.log(self.shape[-1] / NARROW) / math.log(self.ratio))
        widths = [NARROW * self.ratio**i for i in range(count + 1)]
        for width in widths:
            yield self.state_dict() | {
                "value": self.value.new_tensor(math.log(width) / self.preconditioning_scale)
            }

    def _axis(self) -> Tensor:
        radius = self.shape[-1] // 2
        return torch.arange(-radius, radius + 1, dtype=self.value.dtype, device=self.value.device)

    def _spread(self, kernel: Tensor) -> Tensor:
        squares = self._axis().square()
        return (kernel * (squares[:, None] + squares)).sum() / kernel.sum()


def over_pixels(axis: Tensor, function: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """The mean of a function of (x, y) over the area of each pixel at `axis`, (n, n)."""
    inside = (torch.arange(FINE, dtype=axis.dtype, device=axis.device) + 0.5) / FINE - 0.5
    fine = (axis[:, None] + inside).flatten()
    return F.avg_pool2d(function(fine, fine[:, None])[None, None], FINE)[0, 0]
