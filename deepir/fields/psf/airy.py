"""Diffraction at a round aperture."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.fields.psf.base import PSF
from deepir.registry import register

#: First positive zero of the Bessel function J1.
FIRST_ZERO_OF_J1 = 3.8317059702075125
#: Nodes of the quadrature: exact to 1e-6 up to ten rings.
N_QUADRATURE_NODES = 48


@register("field", "airy")
class Airy(PSF):
    """Airy pattern (1, 1, 2 r + 1, 2 r + 1), sum one; `radius`, of its first dark ring in px, is free.

    That is 1.22 wavelengths times the f-number, over the pitch: 12.2 µm at 10 µm and f/1. (Born and Wolf 1999,
    "Principles of Optics", 8.5.2.) It is sampled at pixel centres. The blur's radius should be two to three of it.
    """

    example_options: ClassVar = {"size": (60, 80), "radius": 2.2}

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], radius: float = 2.0
    ) -> None:
        super().__init__(shape, neutral, size, "radius", radius)

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """`(2 J1(v) / v)²`, normalised, by `J1(v) / v = ∫ sqrt(1 - t²) cos(v t) dt / π`, t from -1 to 1."""
        axis = self._axis()
        v = FIRST_ZERO_OF_J1 * torch.hypot(axis, axis[:, None]) / width
        angle = (
            math.pi
            * torch.arange(1, N_QUADRATURE_NODES + 1, dtype=v.dtype, device=v.device)
            / (N_QUADRATURE_NODES + 1)
        )
        # Gauss-Chebyshev quadrature of the second kind.
        amplitude = torch.cos(v[..., None] * angle.cos()) @ angle.sin().square()
        energy = amplitude.square()
        return (energy / energy.sum()).expand(self.shape)
