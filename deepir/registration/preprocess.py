"""What is taken out of the frames before any motion is known: gain, stripes, stuck pixels."""

from __future__ import annotations

import scipy.ndimage
import torch
from torch import Tensor

from deepir.arrays.median import MAD
from deepir.arrays.subsample import subsample
from deepir.arrays.windows import median_filter

STUCK_THRESHOLD = 10.0  # robust standard deviations; pixels of the mean frame beyond are stuck
STRIPE_WINDOW = 31  # px across the lines; broader structure is no stripe


def preprocess(frames: Tensor, ignore: Tensor | None) -> tuple[Tensor, Tensor]:
    """Frames `(N, H, W)` float32, gains made offsets, without stripes; weights `(H, W)`, zero where bad."""
    good = torch.ones(frames.shape[1:], dtype=torch.bool)
    for frame in frames:
        good &= frame.isfinite()
    if ignore is not None:
        good &= ~ignore
    if not good.any():
        return torch.zeros(frames.shape), good.float()
    y = log_or_centre(frames, good)
    mean = y.mean(0)
    lines = line_pattern(mean, 0) + line_pattern(mean, 1)
    good &= ~stuck_pixels(mean - lines)
    if len(frames) < 3:
        y -= lines
    return y.mul_(good), good.float()


def log_or_centre(frames: Tensor, good: Tensor) -> Tensor:
    """Logarithm over the median, at least 0.05 of it; or what differs from it, if the frames are not positive."""
    values, known = subsample(frames, good.expand_as(frames))
    known_values = values[known]
    centre = float(known_values.median())
    positive = centre > 0 and float((known_values <= 0).double().mean()) <= 0.05
    y = torch.empty(frames.shape)
    for frame, out in zip(frames, y, strict=True):
        out.copy_(frame).masked_fill_(~good, centre)
        if positive:
            out.div_(centre).clamp_min_(0.05).log_()
        else:
            out.sub_(centre)
    return y


def line_pattern(image: Tensor, axis: int) -> Tensor:
    """Structure of lines along `axis`: their median of what differs from the mean over some px across them."""
    broad = scipy.ndimage.uniform_filter1d(image.numpy(), STRIPE_WINDOW, axis=1 - axis, mode="nearest")
    return (image - torch.from_numpy(broad)).median(axis, keepdim=True).values


def stuck_pixels(image: Tensor) -> Tensor:
    """Pixels `(H, W)` that differ from their 3 x 3 median by `STUCK` robust deviations."""
    deviation = (image - median_filter(image[None, None])[0, 0]).abs()
    scale = MAD * float(subsample(deviation[None])[0].median())
    return deviation > (STUCK_THRESHOLD * scale or torch.inf)
