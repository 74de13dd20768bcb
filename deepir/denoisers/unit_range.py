"""Denoisers that others have made, for pictures in [0, 1]."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def unit_range(model: Callable[[Tensor, float], Tensor]) -> Callable[[Tensor, float], Tensor]:
    """A denoiser of pictures in any unit from one of pictures (B, 1, H, W) in [0, 1], `model(picture, sigma)`.

    Those of the package deepinv are of that kind. Give the result to `RED`, or give it a name by `register`.
    """

    def denoise(picture: Tensor, noise: float) -> Tensor:
        """A denoiser for pictures in [0, 1]."""
        low = picture.min()
        span = (picture.max() - low).clamp(min=1e-30)
        with torch.no_grad():
            found = model(((picture - low) / span).float(), float(noise / span))
        return found.to(picture) * span + low

    return denoise
