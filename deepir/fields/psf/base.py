"""Point spread functions as fields: the interface, a fixed one, and a free one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.errors import ConfigError
from deepir.fields.base import Field, Shape
from deepir.fields.constant import Constant, read_map
from deepir.fields.motion import PARAMETER_SCALE
from deepir.registry import register

#: Largest width, px.
MAX_WIDTH = 1e2
#: Smallest width of a search, px: narrower kernels are indistinguishable.
MIN_WIDTH = 0.4
#: Quadrature points along the side of a pixel.
POINTS_PER_PIXEL = 8
#: Width of the soft edge of a kernel, px.
EDGE_WIDTH = 0.2
#: Smallest initial value relative to the largest: exact zeros would remain zero.
MIN_INITIAL_RATIO = 1e-4


class PSF(Field):
    """A point-spread function (1, 1, 2 r + 1, 2 r + 1) of sum one; its width in px is free, and positive.

    Of shape (N, 1, 2 r + 1, 2 r + 1) it is one for each frame, each with a width of its own.

    A subclass gives the kernel for a width. It is that of the optics: the pixels' own area is `downsample`'s.
    """

    #: Ratio of successive initial widths of a search; small where the spectrum has zeros.
    search_ratio: ClassVar[float] = 1.1
    example_shape = (1, 1, 9, 9)

    def __init__(self, shape: Shape, neutral: float, size: tuple[int, int], name: str, width: float) -> None:
        super().__init__(shape, neutral)
        if not 0 < width < math.inf:
            raise ValueError(f"{name} must be a positive number of px, not {width}")
        self.preconditioning_scale = PARAMETER_SCALE / math.sqrt(size[0] * size[1])
        widths = self.shape[:1] if self.shape[0] > 1 else ()
        self.value = nn.Parameter(torch.full(widths, math.log(width) / self.preconditioning_scale))

    @property
    def width(self) -> Tensor:
        """The width in px, a scalar; or one for each frame, (N,)."""
        return (self.preconditioning_scale * self.value).exp()

    def forward(self) -> Tensor:
        """The normalised kernel."""
        return torch.cat([self.kernel_of_width(width)[:1] for width in self.width.reshape(-1)])

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised kernel of a width, expanded to the shape."""
        raise NotImplementedError

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over the width: the kernel with the mean squared radius of `value`, by bisection."""
        widths = [self._width_of(kernel) for kernel in value.to(self.value).expand(self.shape)]
        self.value.copy_(torch.stack(widths).reshape(self.value.shape).log() / self.preconditioning_scale)

    def _width_of(self, kernel: Tensor) -> Tensor:
        target = self._mean_squared_radius(kernel)
        low, high = (self.value.new_tensor(bound) for bound in (1 / MAX_WIDTH, MAX_WIDTH))
        for _ in range(60):
            middle = (low * high).sqrt()
            narrow = self._mean_squared_radius(self.kernel_of_width(middle)[0]) < target
            low, high = torch.where(narrow, middle, low), torch.where(narrow, high, middle)
        return (low * high).sqrt()

    @torch.no_grad()
    def search_starts(self) -> Iterator[dict[str, Tensor]]:
        """States from which a search for the parameters may begin: widths up to the radius."""
        count = math.ceil(math.log(self.shape[-1] / MIN_WIDTH) / math.log(self.search_ratio))
        for i in range(count + 1):
            value = math.log(MIN_WIDTH * self.search_ratio**i) / self.preconditioning_scale
            yield self.state_dict() | {"value": torch.full_like(self.value, value)}

    def _axis(self) -> Tensor:
        radius = self.shape[-1] // 2
        return torch.arange(-radius, radius + 1, dtype=self.value.dtype, device=self.value.device)

    def _mean_squared_radius(self, kernel: Tensor) -> Tensor:
        squares = self._axis().square()
        return (kernel * (squares[:, None] + squares)).sum() / kernel.sum()


def pixel_average(axis: Tensor, function: Callable[[Tensor, Tensor], Tensor]) -> Tensor:
    """The mean of a function of (x, y) over the area of each pixel at `axis`, (n, n)."""
    inside = (torch.arange(POINTS_PER_PIXEL, dtype=axis.dtype, device=axis.device) + 0.5) / POINTS_PER_PIXEL - 0.5
    fine = (axis[:, None] + inside).flatten()
    return F.avg_pool2d(function(fine, fine[:, None])[None, None], POINTS_PER_PIXEL)[0, 0]


@register("field", "kernel")
class Kernel(Constant):
    """A known point-spread function from a file, scaled to sum one; one pixel without.

    Its sides are odd, and up to the slot's (2 r + 1, 2 r + 1), in whose middle it is put.
    """

    example_shape = (1, 1, 3, 3)

    def __init__(self, shape: Shape, neutral: float = 0.0, *, path: str | None = None) -> None:
        super().__init__(shape, 0.0)
        given = torch.ones(1, 1, 1) if path is None else read_map(path)
        rest = [whole - side for whole, side in zip(shape[-2:], given.shape[-2:], strict=True)]
        if len(given) > 1 or min(rest) < 0 or any(each % 2 for each in rest):
            raise ConfigError(
                f"{path}: a point-spread function has odd sides of up to {shape[-2]} px, "
                f"not {tuple(given.shape[-2:])}; the blur's radius is half of that"
            )
        total = float(given.sum())
        if not 0 < total < float("inf"):
            raise ConfigError(f"{path}: a point-spread function has a positive sum, not {total:g}")
        top, left = (each // 2 for each in rest)
        self.values[..., top : shape[-2] - top, left : shape[-1] - left] = given / total


@register("field", "simplex")
class Simplex(Field):
    """Free values that are not negative and sum to one: a point-spread function of any shape.

    They are squares, scaled. It starts as a narrow Gaussian; from a file with `init`.
    """

    example_shape = (1, 1, 5, 5)
    example_options: ClassVar = {"size": (60, 80)}

    def __init__(self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int]) -> None:
        super().__init__(shape, neutral)
        self.preconditioning_scale = PARAMETER_SCALE / (size[0] * size[1]) ** 0.5
        self.values = nn.Parameter(torch.zeros(self.shape))
        y, x = (torch.arange(side) - side // 2 for side in self.shape[-2:])
        self.init_from(torch.exp(-(x**2 + y[:, None] ** 2) / 2.0))

    def forward(self) -> Tensor:
        """`values² / Σ values²`, of each frame."""
        squares = self.values.square()
        return squares / squares.sum((-2, -1), keepdim=True)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over what is not negative, scaled to sum one."""
        value = value.to(self.values).expand(self.shape).clamp(min=0)
        value = value.clamp(min=MIN_INITIAL_RATIO * float(value.max()))
        self.values.copy_((value / value.sum((-2, -1), keepdim=True)).sqrt() / self.preconditioning_scale)
