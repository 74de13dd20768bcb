"""Point-spread functions: known or free, or of a width: a Gaussian, diffraction, defocus, a straight motion."""

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

MAX_WIDTH = 1e2  # largest width, px
MIN_WIDTH = 0.4  # smallest width of a search, px: narrower kernels are indistinguishable
POINTS_PER_PIXEL = 8  # quadrature points along the side of a pixel
EDGE_WIDTH = 0.2  # width of the soft edge of a kernel, px
MIN_INITIAL_RATIO = 1e-4  # smallest initial value relative to the largest: exact zeros would remain zero
FIRST_ZERO_OF_J1 = 3.8317059702075125  # first positive zero of the Bessel function J1
N_QUADRATURE_NODES = 48  # nodes of the quadrature: exact to 1e-6 up to ten rings


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


@register("field", "gaussian")
class Gaussian(PSF):
    """Isotropic Gaussian point-spread function (1, 1, 2 r + 1, 2 r + 1), sum one; `sigma` in px is free.

    It is sampled at pixel centres, not integrated over pixels: that is `downsample`'s. Far below 0.4 px it is
    one pixel. The blur's radius should be 3 sigma.
    """

    example_options: ClassVar = {"size": (60, 80), "sigma": 1.3}

    def __init__(self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], sigma: float = 1.0) -> None:
        super().__init__(shape, neutral, size, "sigma", sigma)

    @property
    def sigma(self) -> Tensor:
        """Standard deviation in px, a scalar."""
        return self.width

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised kernel of a standard deviation."""
        line = torch.softmax(-((self._axis() / width) ** 2) / 2, 0)
        return (line[:, None] * line).expand(self.shape)


class RoundPSF(PSF):
    """A point-spread function (1, 1, 2 r + 1, 2 r + 1) whose width is the radius of a disc or ring, px."""

    example_options: ClassVar = {"size": (60, 80), "radius": 2.2}

    def __init__(self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], radius: float = 2.0) -> None:
        super().__init__(shape, neutral, size, "radius", radius)


@register("field", "airy")
class Airy(RoundPSF):
    """Airy pattern (1, 1, 2 r + 1, 2 r + 1), sum one; `radius`, of its first dark ring in px, is free.

    That is 1.22 wavelengths times the f-number, over the pitch: 12.2 µm at 10 µm and f/1. (Born and Wolf 1999,
    "Principles of Optics", 8.5.2.) It is sampled at pixel centres. The blur's radius should be two to three of it.
    """

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """`(2 J1(v) / v)²`, normalised, by `J1(v) / v = ∫ sqrt(1 - t²) cos(v t) dt / π`, t from -1 to 1."""
        axis = self._axis()
        v = FIRST_ZERO_OF_J1 * torch.hypot(axis, axis[:, None]) / width
        angle = (
            math.pi * torch.arange(1, N_QUADRATURE_NODES + 1, dtype=v.dtype, device=v.device) / (N_QUADRATURE_NODES + 1)
        )
        # Gauss-Chebyshev quadrature of the second kind.
        amplitude = torch.cos(v[..., None] * angle.cos()) @ angle.sin().square()
        energy = amplitude.square()
        return (energy / energy.sum()).expand(self.shape)


@register("field", "defocus")
class Defocus(RoundPSF):
    """The disc that a lens out of focus makes of a point, (1, 1, 2 r + 1, 2 r + 1), sum one; `radius` in px is free.

    It has an edge, so that it is integrated over pixels. The blur's radius should be a px more than its own.
    """

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised disc of a radius."""
        found = pixel_average(self._axis(), lambda x, y: ((width - (x**2 + y**2).sqrt()) / EDGE_WIDTH).sigmoid())
        return (found / found.sum()).expand(self.shape)


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
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], length: float = 3.0, angle: float = 0.0
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
            ends = ((width / 2 - along) / EDGE_WIDTH).sigmoid() - ((-width / 2 - along) / EDGE_WIDTH).sigmoid()
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
