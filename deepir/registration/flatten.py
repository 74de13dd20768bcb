"""What is taken out of the frames before any motion is known: gain, stripes, stuck pixels."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import torch
from torch import Tensor

STUCK = 7.0  # robust standard deviations beyond which a pixel of the mean frame is stuck


def flatten(frames: Tensor, ignore: Tensor | None) -> tuple[Tensor, Tensor]:
    """Frames `(N, H, W)`, float64, gains made offsets, unit spread; weights `(H, W)`, zero where bad."""
    good = frames.isfinite().all(0)
    if ignore is not None:
        good = good & ~ignore
    y = logarithm(torch.where(good, frames, frames[:, good].median() if good.any() else 0.0).double())
    good = good & ~stuck(without_stripes(y, 15).mean(0))
    y = y - (y * good).sum((1, 2), keepdim=True) / good.sum().clamp_min(1)
    y = y / (y * good).square().mean().sqrt().clamp_min(1e-12)
    return y, good.float()


def without_stripes(frames: Tensor, window: int) -> Tensor:
    """Frames less the column and row structure of their mean, as float32: `(N, H, W)`.

    A stripe is the median along a line of what differs from the mean over `window` px across the lines.
    Narrow, it leaves the broad part of the stripes; wide, it takes the scene's own profile with it, which
    plants a ghost that stands still.
    """
    image = frames.mean(0).numpy()
    columns = np.median(image - scipy.ndimage.uniform_filter1d(image, window, axis=1, mode="nearest"), axis=0)
    rows = np.median(image - scipy.ndimage.uniform_filter1d(image, window, axis=0, mode="nearest"), axis=1)
    return (frames - torch.from_numpy(columns[None] + rows[:, None])).float()


def logarithm(frames: Tensor) -> Tensor:
    """The logarithm (floored at 5 % of the median), or the frames themselves if they are not positive."""
    middle = frames.median()
    if middle <= 0 or (frames <= 0).double().mean() > 0.05:
        return frames
    return frames.clamp_min(0.05 * float(middle)).log()


def stuck(mean: Tensor) -> Tensor:
    """Pixels `(H, W)` of the mean that differ from their 3 x 3 median by `STUCK` robust deviations."""
    image = mean.numpy().astype(np.float32)
    apart = np.abs(image - scipy.ndimage.median_filter(image, 3, mode="nearest"))
    scale = 1.4826 * float(np.median(apart))
    return torch.from_numpy(apart > STUCK * scale) if scale > 0 else torch.from_numpy(apart > np.inf)
