"""Windows and differences of arrays, and values filled in."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

DEFAULT_WINDOW = 5  # side of a neighbourhood, px


def squared_gradient(value: Tensor) -> Tensor:
    """Squared gradient `|∇x|²` (..., H, W) by forward differences; zero across the lower and right border."""
    down = value.diff(dim=-2, append=value[..., -1:, :])
    right = value.diff(dim=-1, append=value[..., :, -1:])
    return down.square() + right.square()


def fill_nearest(image: Tensor, known: Tensor) -> Tensor:
    """Fill pixels of an image (S, C, H, W) that are not `known` with the nearest of the row; else of the column."""
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
    """Fill pixels of an image (S, C, H, W) that are not `known` smoothly by pull-push over a pyramid of 2 x 2 averages.

    It is unchanged if nothing is known.

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


def median_filter(image: Tensor) -> Tensor:
    """Median of the 3 x 3 px around each px of an image (1, 1, h, w), without NaN; the border is repeated."""
    from deepir.kernels.median_filter import median_filter as of_array

    found = of_array(image[0, 0].numpy(force=True), 3)
    return torch.from_numpy(found)[None, None].to(image)


def box_sum(images: Tensor, window: int = DEFAULT_WINDOW) -> Tensor:
    """Sum of images (N, 1, h, w) over each window of an odd side, px, with zeros beyond the border.

    Shifted images are added, which is twenty times as fast as the pooling of torch.
    """
    if len(images) > 1:  # one at a time stays in the cache
        return torch.cat([box_sum(image[None], window) for image in images])
    for axis in (-2, -1):
        side, pad = images.shape[axis], window // 2
        padded = F.pad(images, (pad, pad, 0, 0) if axis == -1 else (0, 0, pad, pad))
        images = padded.narrow(axis, 0, side).clone()
        for shift in range(1, window):
            images += padded.narrow(axis, shift, side)
    return images
