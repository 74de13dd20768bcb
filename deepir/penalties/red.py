"""Regularisation by any denoiser."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from deepir.penalties.penalty import Penalty
from deepir.priors.field import Shape
from deepir.registry import lookup, register


@register("penalty", "red")
class RED(Penalty):
    """Half the squared distance of the picture from what a denoiser makes of it, `½ Σ (x - D(x))²`.

    (Romano, Elad, Milanfar 2017, "The little engine that could: regularization by denoising", solved by fixed points:
    `D(x)` is held during a stage, and found anew at the begin of the next.)

    Args:
        shape: Of the value.
        denoiser: The name of one, or a function `(picture (S, C, H, W), noise) -> picture`.
        strength: Of the noise that the denoiser is told, in standard deviations of the picture's. What `D(x)` is
            averaged with is less noisy than the data.
    """

    of_image = True
    target: Tensor

    def __init__(
        self,
        shape: Shape,
        *,
        weight: float | None = None,
        denoiser: str | Callable[[Tensor, float], Tensor] = "dct",
        strength: float = 0.35,
    ) -> None:
        super().__init__(weight=weight)
        if not 0 < strength < float("inf"):
            raise ValueError(f"strength must be a positive number, not {strength}")
        self.denoise = denoiser if callable(denoiser) else lookup("denoiser", denoiser, "denoiser")
        self.strength = strength
        self.register_buffer("target", torch.zeros(shape))

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ (x - D(x))²`, with `D(x)` as it was found last."""
        return (value - self.target).square().sum(dtype=torch.float64) / 2

    def adapt(self, value: Tensor, noise: float) -> None:
        """Denoise the picture."""
        self.target.copy_(self.denoise(value, self.strength * noise))

    def natural(self, noise: float) -> float:
        """The denoised picture counts as much as eight bursts."""
        return 8 / noise**2

    def stiffness(self, value: Tensor) -> tuple[float, float]:
        """The weight."""
        return float(self.weight), 0.0

    @classmethod
    def example(cls, **options: Any) -> RED:
        """For a picture of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)
