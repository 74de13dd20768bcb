"""A point-spread function with one parameter."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from deepir.priors.field import Field, Shape
from deepir.priors.motion import STEP
from deepir.registry import register


@register("field", "gaussian")
class Gaussian(Field):
    """Isotropic Gaussian point-spread function (1, 1, 2 r + 1, 2 r + 1), sum one; `sigma` in px is free.

    It is sampled at pixel centres, not integrated over pixels: that is `downsample`'s. Far below 0.4 px it is
    one pixel. The blur's radius should be 3 sigma.
    """

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], sigma: float = 1.0
    ) -> None:
        super().__init__(shape, neutral)
        if not 0 < sigma < math.inf:
            raise ValueError(f"sigma must be a positive number of px, not {sigma}")
        self.step = STEP / math.sqrt(size[0] * size[1])
        self.value = nn.Parameter(torch.tensor(math.log(sigma) / self.step))

    @property
    def sigma(self) -> Tensor:
        """Standard deviation in px, a scalar."""
        return (self.step * self.value).exp()

    def forward(self) -> Tensor:
        """The normalised kernel."""
        return self._kernel(self.sigma)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over the width: the kernel with the mean squared radius of `value`, by bisection."""
        target = self._spread(value.to(self.value))
        low, high = (self.value.new_tensor(bound) for bound in (1e-2, 1e2))
        for _ in range(60):
            middle = (low * high).sqrt()
            narrow = self._spread(self._kernel(middle)) < target
            low, high = torch.where(narrow, middle, low), torch.where(narrow, high, middle)
        self.value.copy_((low * high).sqrt().log() / self.step)

    def _axis(self) -> Tensor:
        radius = self.shape[-1] // 2
        return torch.arange(-radius, radius + 1, dtype=self.value.dtype, device=self.value.device)

    def _kernel(self, sigma: Tensor) -> Tensor:
        line = torch.softmax(-((self._axis() / sigma) ** 2) / 2, 0)
        return (line[:, None] * line).expand(self.shape)

    def _spread(self, kernel: Tensor) -> Tensor:
        squares = self._axis().square()
        return (kernel * (squares[:, None] + squares)).sum() / kernel.sum()

    @classmethod
    def example(cls) -> Gaussian:
        """A kernel of 9 x 9 px."""
        return cls((1, 1, 9, 9), size=(60, 80), sigma=1.3)
