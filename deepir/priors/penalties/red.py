"""Regularisation by any denoiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from deepir.fields.base import Shape, check_positive
from deepir.priors.penalties.base import Penalty
from deepir.registry import lookup, register

STRENGTH_DECAY = 0.8  # denoiser strength relative to that of the stage before


@register("penalty", "red")
class RED(Penalty):
    """Regularisation by denoising: `½ Σ (x - D(x))²` with a denoiser D.

    Solved by fixed points: `D(x)` is constant during a stage and updated at the start of the next, on a value that is
    turned or mirrored another way in each, which averages what the denoiser does along directions of its own.

    Args:
        shape: Of the value.
        weight: Fixed weight; None for `auto`.
        denoiser: Registered name, or a function `(image (S, C, H, W), sigma) -> image`.
        strength: Standard deviation passed to the denoiser, relative to that of the noise of the value.
        first: Strength in the first stage, from which it decreases by a fifth per stage; `strength` if None. A
            stronger start helps where the data determine little (Zhang et al. 2021, "Plug-and-play image restoration
            with deep denoiser prior"); the noise then determines the weight, too.
        trust: Default weight, in inverse variances passed to the denoiser.

    Raises:
        ValueError: An option is not positive and finite.

    Source: Romano, Elad, Milanfar 2017, "The little engine that could: regularization by denoising".
    """

    acts_on_pixels = True
    target: Tensor
    stage: Tensor

    def __init__(
        self,
        shape: Shape,
        *,
        weight: float | None = None,
        denoiser: str | Callable[[Tensor, float], Tensor] = "dct",
        strength: float = 0.35,
        first: float | None = None,
        trust: float = 0.98,
    ) -> None:
        super().__init__(weight=weight)
        self.weighed_by_noise = first is not None
        check_positive(strength=strength, first=strength if first is None else first, trust=trust)
        self.denoise = denoiser if callable(denoiser) else lookup("denoiser", denoiser, "denoiser")
        self.strength, self.first, self.trust = strength, first or strength, trust
        self.register_buffer("target", torch.zeros(shape))
        self.register_buffer("stage", torch.tensor(0))

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ (x - D(x))²`, with the last `D(x)`."""
        return (value - self.target).square().sum(dtype=torch.float64) / 2

    def adapt(self, value: Tensor, noise: float) -> None:
        """Update `D(x)`; the strength then decreases, down to `strength`."""
        turns, mirrored = int(self.stage) % 4, int(self.stage) % 8 >= 4
        turned = torch.rot90(value.mT if mirrored else value, turns, (-2, -1))
        found = torch.rot90(self.denoise(turned, self._denoiser_sigma() * noise), -turns, (-2, -1))
        self.target.copy_(found.mT if mirrored else found)
        self.stage += 1

    def default_weight(self, sigma: float) -> float:
        """`trust` over the variance passed to the denoiser."""
        return self.trust / (self._denoiser_sigma() * sigma) ** 2

    def _denoiser_sigma(self) -> float:
        """Standard deviation passed to the denoiser in this stage, relative to that of the noise."""
        return max(self.strength, self.first * STRENGTH_DECAY ** int(self.stage))

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight."""
        return float(self.weight), 0.0

    @classmethod
    def example(cls, **options: Any) -> RED:
        """For a picture of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)
