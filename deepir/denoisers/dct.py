"""Thresholding of the cosine transform of all blocks."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.registry import register

SIDE = 8  # px of a block
THRESHOLD = 2.7  # standard deviations of the noise below which a coefficient is taken for noise


@register("denoiser", "dct")
def dct(picture: Tensor, noise: float) -> Tensor:
    """Hard thresholding of the cosine transform of all 8 x 8 blocks; those with few terms left count more.

    (Yaroslavsky, Egiazarian, Astola 2001, "Transform domain image restoration methods"; the weights of Dabov et al.
    2007, "Image denoising by sparse 3-D transform-domain collaborative filtering".)
    """
    waves = _waves().to(picture)
    margin = SIDE - 1
    flat = picture.reshape(-1, 1, *picture.shape[-2:])
    found = F.conv2d(F.pad(flat, (margin,) * 4, mode="replicate"), waves)
    kept = found.abs() > THRESHOLD * noise
    kept[:, 0] = True  # the mean
    weight = 1 / kept.sum(1, keepdim=True).to(flat)
    total = F.conv_transpose2d(found * kept * weight, waves)
    share = F.conv_transpose2d(weight, torch.ones_like(waves[:1]))
    return (total / share)[..., margin:-margin, margin:-margin].reshape(picture.shape)


def _waves() -> Tensor:
    """The orthonormal cosines on a block, (64, 1, 8, 8), the constant first."""
    order, at = torch.arange(SIDE)[:, None], torch.arange(SIDE) + 0.5
    wave = torch.cos(math.pi * order * at / SIDE) * math.sqrt(2 / SIDE)
    wave[0] /= math.sqrt(2)
    return torch.einsum("iy,jx->ijyx", wave, wave).reshape(-1, 1, SIDE, SIDE)
