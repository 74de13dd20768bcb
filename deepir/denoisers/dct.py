"""Thresholding of the cosine transform of all blocks."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.registry import register

BLOCK_SIDE = 8  # side of a block, px
#: Coefficients below this are set to zero, noise standard deviations (Dabov et al. 2007).
HARD_THRESHOLD = 2.7


@register("denoiser", "dct")
def dct(picture: Tensor, noise: float) -> Tensor:
    """Hard thresholding of the discrete cosine transform of all 8 x 8 blocks, weighted by sparsity.

    Source: Yaroslavsky, Egiazarian, Astola 2001, "Transform domain image restoration methods"; weights of Dabov et al.
    2007, "Image denoising by sparse 3-D transform-domain collaborative filtering".
    """
    waves = _waves().to(picture)
    margin = BLOCK_SIDE - 1
    flat = picture.reshape(-1, 1, *picture.shape[-2:])
    found = F.conv2d(F.pad(flat, (margin,) * 4, mode="replicate"), waves)
    kept = found.abs() > HARD_THRESHOLD * noise
    kept[:, 0] = True  # the mean
    weight = 1 / kept.sum(1, keepdim=True).to(flat)
    total = F.conv_transpose2d(found * kept * weight, waves)
    weight_sum = F.conv_transpose2d(weight, torch.ones_like(waves[:1]))
    return (total / weight_sum)[..., margin:-margin, margin:-margin].reshape(picture.shape)


def _waves() -> Tensor:
    """The orthonormal cosines on a block, (64, 1, 8, 8), the constant first."""
    order, at = torch.arange(BLOCK_SIDE)[:, None], torch.arange(BLOCK_SIDE) + 0.5
    wave = torch.cos(math.pi * order * at / BLOCK_SIDE) * math.sqrt(2 / BLOCK_SIDE)
    wave[0] /= math.sqrt(2)
    return torch.einsum("iy,jx->ijyx", wave, wave).reshape(-1, 1, BLOCK_SIDE, BLOCK_SIDE)
