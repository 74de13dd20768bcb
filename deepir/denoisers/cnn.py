"""A trained network."""

from __future__ import annotations

import functools

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir import weights
from deepir.denoisers.unet import UNet
from deepir.registry import register

MOST = 4.0  # standard deviations: noise does not reach further, so nothing is changed by more
MARGIN = 16  # px: what the network makes up beyond the picture's edge does not reach further


@register("denoiser", "cnn")
def cnn(picture: Tensor, noise: float) -> Tensor:
    """A small U-net, trained by `deepir train denoiser`."""
    network = _network().to(picture)
    flat = picture.reshape(-1, 1, *picture.shape[-2:])
    height, width = flat.shape[-2:]
    bottom, right = (MARGIN + -side % network.multiple for side in (height, width))
    padded = F.pad(flat, (MARGIN, right, MARGIN, bottom), mode="replicate")
    with torch.no_grad():
        found = padded + (network(padded, noise) - padded).clamp(-MOST * noise, MOST * noise)
    return found[..., MARGIN : MARGIN + height, MARGIN : MARGIN + width].reshape(picture.shape)


@functools.cache
def _network() -> UNet:
    return weights.load(UNet(), weights.SHIPPED / "denoiser.safetensors")
