"""Filling of unknown pixels."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def fill_nearest(image: Tensor, known: Tensor) -> Tensor:
    """Fill unknown pixels with the nearest known pixel of the row; of the column, if the row has none.

    Args:
        image: (S, C, H, W).
        known: Same shape, bool.

    Returns:
        The filled image; unchanged where known.
    """
    for axis in (-1, -2):
        side = image.shape[axis]
        at = torch.arange(side, device=image.device).unflatten(0, (-1, 1) if axis == -2 else (1, -1))
        before = at.where(known, -side).cummax(axis).values
        after = at.where(known, 2 * side).flip(axis).cummin(axis).values.flip(axis)
        nearest = before.where(at - before <= after - at, after)
        image = image.gather(axis, nearest.clamp(0, side - 1))
        known = known.any(axis, keepdim=True).expand(known.shape)
    return image


def fill_pull_push(image: Tensor, known: Tensor) -> Tensor:
    """Fill unknown pixels smoothly by pull-push over a pyramid of 2 x 2 averages.

    Args:
        image: (S, C, H, W).
        known: Same shape, bool.

    Returns:
        The filled image; unchanged where known, or if nothing is known.

    Source: Gortler et al. 1996, "The lumigraph", section 3.
    """
    if known.all() or not known.any():
        return image
    height, width = image.shape[-2:]
    odd = (0, width % 2, 0, height % 2)
    weight = F.avg_pool2d(F.pad(known.to(image), odd), 2)
    total = F.avg_pool2d(F.pad(image.where(known, 0), odd), 2)
    coarse = fill_pull_push(total / weight.clamp(min=1e-6), weight > 0)
    fine = F.interpolate(coarse, scale_factor=2, mode="bilinear")[..., :height, :width]
    return torch.where(known, image, fine)
