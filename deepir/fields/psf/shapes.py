"""Point-spread functions of a width: a Gaussian, diffraction, defocus, motion during the exposure."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.fields.psf.base import EDGE_WIDTH, PSF, pixel_average
from deepir.registry import register

#: First positive zero of the Bessel function J1.
FIRST_ZERO_OF_J1 = 3.8317059702075125
#: Nodes of the quadrature: exact to 1e-6 up to ten rings.
N_QUADRATURE_NODES = 48


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
