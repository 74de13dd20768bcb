"""Regularisation by any denoiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.priors.penalties.base import Penalty
from deepir.registry import lookup, register

DECAY = 0.8  # of the strength from one stage to the next


@register("penalty", "red")
class RED(Penalty):
    """Half the squared distance of the picture from what a denoiser makes of it, `½ Σ (x - D(x))²`.

    (Romano, Elad, Milanfar 2017, "The little engine that could: regularization by denoising", solved by fixed points:
    `D(x)` is held during a stage, and found anew at the begin of the next.) Where the data leave much of the picture
    open, the denoiser begins stronger and becomes weaker from stage to stage (Zhang et al. 2021, "Plug-and-play image
    restoration with deep denoiser prior").

    Args:
        shape: Of the value.
        denoiser: The name of one, or a function `(picture (S, C, H, W), noise) -> picture`.
        strength: Of the noise that the denoiser is told, in standard deviations of the picture's. What `D(x)` is
            averaged with is less noisy than the data.
        first: The strength in the first stage, from which it falls by a fifth a stage; `strength` if not given.
        trust: The natural weight, in one over the variance that the denoiser is told.
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
        for name, value in (("strength", strength), ("first", first), ("trust", trust)):
            if value is not None and not 0 < value < float("inf"):
                raise ValueError(f"{name} must be a positive number, not {value}")
        self.denoise = denoiser if callable(denoiser) else lookup("denoiser", denoiser, "denoiser")
        self.strength, self.first, self.trust = strength, first or strength, trust
        self.register_buffer("target", torch.zeros(shape))
        self.register_buffer("stage", torch.tensor(0))

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ (x - D(x))²`, with `D(x)` as it was found last."""
        return (value - self.target).square().sum(dtype=torch.float64) / 2

    def adapt(self, value: Tensor, noise: float) -> None:
        """Denoise the picture; the next time more weakly, down to `strength`."""
        self.target.copy_(self.denoise(value, self._denoiser_sigma() * noise))
        self.stage += 1

    def default_weight(self, sigma: float) -> float:
        """`trust` over the variance of the noise that the denoiser is told; by default, as much as eight bursts."""
        return self.trust / (self._denoiser_sigma() * sigma) ** 2

    def _denoiser_sigma(self) -> float:
        """Strength in this stage."""
        return max(self.strength, self.first * DECAY ** int(self.stage))

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight."""
        return float(self.weight), 0.0

    @classmethod
    def example(cls, **options: Any) -> RED:
        """For a picture of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)
