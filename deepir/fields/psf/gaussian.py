"""A Gaussian point-spread function."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.fields.psf.base import PSF
from deepir.registry import register


@register("field", "gaussian")
class Gaussian(PSF):
    """Isotropic Gaussian point-spread function (1, 1, 2 r + 1, 2 r + 1), sum one; `sigma` in px is free.

    It is sampled at pixel centres, not integrated over pixels: that is `downsample`'s. Far below 0.4 px it is
    one pixel. The blur's radius should be 3 sigma.
    """

    example_options: ClassVar = {"size": (60, 80), "sigma": 1.3}

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], sigma: float = 1.0
    ) -> None:
        super().__init__(shape, neutral, size, "sigma", sigma)

    @property
    def sigma(self) -> Tensor:
        """Standard deviation in px, a scalar."""
        return self.width

    def kernel_of_width(self, width: Tensor) -> Tensor:
        """The normalised kernel of a standard deviation."""
        line = torch.softmax(-((self._axis() / width) ** 2) / 2, 0)
        return (line[:, None] * line).expand(self.shape)
