"""What is taken out of the frames before any motion is known: gain, stripes, stuck pixels."""

from __future__ import annotations

import scipy.ndimage
import torch
from torch import Tensor

from deepir.arrays.statistics import MAD_TO_SIGMA, subsample
from deepir.arrays.windows import median_filter

STUCK = 10.0  # robust standard deviations beyond which a pixel of the mean frame is stuck
WINDOW = 31  # px across the stripes: what is broader is none


def preprocess(frames: Tensor, ignore: Tensor | None) -> tuple[Tensor, Tensor]:
    """Frames `(N, H, W)` float32, gains made offsets, without stripes; weights `(H, W)`, zero where bad."""
    good = torch.ones(frames.shape[1:], dtype=torch.bool)
    for frame in frames:
        good &= frame.isfinite()
    if ignore is not None:
        good &= ~ignore
    if not good.any():
        return torch.zeros(frames.shape), good.float()
    y = logarithm(frames, good)
    mean = y.mean(0)
    standing = stripes(mean, 0) + stripes(mean, 1)
    good &= ~stuck(mean - standing)
    if len(frames) < 3:
        y -= standing
    return y.mul_(good), good.float()


def logarithm(frames: Tensor, good: Tensor) -> Tensor:
    """Logarithm over the median, at least 0.05 of it; or what differs from it, if the frames are not positive."""
    values, known = subsample(frames, good.expand_as(frames))
    few = values[known]
    middle = float(few.median())
    positive = middle > 0 and float((few <= 0).double().mean()) <= 0.05
    y = torch.empty(frames.shape)
    for frame, out in zip(frames, y, strict=True):
        out.copy_(frame).masked_fill_(~good, middle)
        if positive:
            out.div_(middle).clamp_min_(0.05).log_()
        else:
            out.sub_(middle)
    return y


def stripes(image: Tensor, axis: int) -> Tensor:
    """Structure of lines along `axis`: their median of what differs from the mean over some px across them."""
    broad = scipy.ndimage.uniform_filter1d(image.numpy(), WINDOW, axis=1 - axis, mode="nearest")
    return (image - torch.from_numpy(broad)).median(axis, keepdim=True).values


def stuck(image: Tensor) -> Tensor:
    """Pixels `(H, W)` that differ from their 3 x 3 median by `STUCK` robust deviations."""
    apart = (image - median_filter(image[None, None])[0, 0]).abs()
    scale = MAD_TO_SIGMA * float(subsample(apart[None])[0].median())
    return apart > (STUCK * scale or torch.inf)
