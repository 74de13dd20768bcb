"""Adapter for denoisers of images in [0, 1]."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor


def unit_range(model: Callable[[Tensor, float], Tensor]) -> Callable[[Tensor, float], Tensor]:
    """Denoiser for any units from `model(image, sigma)` for images (B, 1, H, W) in [0, 1].

    Models of the package deepinv have this form. Pass the result to `RED`, or register it under a name.
    """

    def denoise(picture: Tensor, noise: float) -> Tensor:
        """A denoiser for pictures in [0, 1]."""
        low = picture.min()
        span = (picture.max() - low).clamp(min=1e-30)
        with torch.no_grad():
            found = model(((picture - low) / span).float(), float(noise / span))
        return found.to(picture) * span + low

    return denoise
