"""A trained network."""

from __future__ import annotations

import functools

import torch
from torch import Tensor

from deepir import weights
from deepir.denoisers.unet import UNet
from deepir.registry import register

#: Largest change of a pixel, noise standard deviations: noise does not reach further.
MAX_CHANGE_SIGMAS = 4.0


@register("denoiser", "cnn")
def cnn(picture: Tensor, noise: float) -> Tensor:
    """A small U-net, trained by `deepir train denoiser`."""
    network = _network().to(picture)
    flat = picture.reshape(-1, 1, *picture.shape[-2:])
    with torch.no_grad():
        found = flat + (network.of_any_size(flat, noise) - flat).clamp(
            -MAX_CHANGE_SIGMAS * noise, MAX_CHANGE_SIGMAS * noise
        )
    return found.reshape(picture.shape)


@functools.cache
def _network() -> UNet:
    return weights.load(UNet(), weights.SHIPPED / "denoiser.safetensors")
