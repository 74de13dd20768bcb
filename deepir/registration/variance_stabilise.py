"""Frames bent so that their fixed pattern is as strong where the scene is bright as where it is dark."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.optimize
import torch
from torch import Tensor

NEAR = 7  # px: beside the mean over so many a pixel's gain and offset are seen
BESIDE = 5  # px: over so many a bad pixel is filled in, if more than
LITTLE = 0.03  # of them are good; over more, where there are none
PARTS = 8  # of the pixels, from dark to bright
KNEE = (0.05, 50.0)  # bounds, in root mean squares of the flux: nearly the logarithm, nearly nothing


def variance_stabilise(frames: Tensor, weight: Tensor) -> Tensor:
    """Frames `(N, h, w)` float64 of an even pattern, filled in where weights `(h, w)` are not one.

    Gains and offsets with variances `a` and `b` are a pattern of variance `a z^2 + b` in a flux z, and an even one in
    `asinh(z / k)`, with `k^2 = b / a` (Bartlett 1947): a logarithm where gains rule, next to nothing where offsets do.
    """
    frames = fill_bad_pixels(frames, weight == 1)
    return (frames / asinh_scale(frames.mean(0).numpy())).asinh()


def fill_bad_pixels(frames: Tensor, good: Tensor) -> Tensor:
    """Frames `(N, h, w)` float64 whose pixels that are not good are means over the least window in which some are."""
    found, unknown, window = torch.where(good, frames.double(), 0.0), ~good, BESIDE
    if not good.any():
        return found
    known, fraction = found.numpy(), good.double().numpy()
    while unknown.any():
        local_fraction = scipy.ndimage.uniform_filter(fraction, window, mode="constant")
        means = scipy.ndimage.uniform_filter(
            known, (0, window, window), mode="constant"
        ) / local_fraction.clip(1e-9)
        fillable = unknown & torch.from_numpy(local_fraction > LITTLE)
        found, unknown, window = (
            torch.where(fillable, torch.from_numpy(means), found),
            unknown & ~fillable,
            2 * window + 1,
        )
    return found


def asinh_scale(image: np.ndarray) -> float:
    """The flux at which gains make as strong a pattern as offsets, as the bright and dark parts of an image tell."""
    local_mean = scipy.ndimage.uniform_filter(image, NEAR, mode="nearest")
    rms = float(np.sqrt(np.mean(local_mean**2))) or 1.0
    bins = np.array_split(local_mean.ravel().argsort(), PARTS)
    flux, deviation = local_mean.ravel() / rms, np.abs(image - local_mean).ravel() / rms
    mean_square = np.array([np.mean(flux[pixels] ** 2) for pixels in bins])
    pattern_power = np.array([np.median(deviation[pixels]) ** 2 for pixels in bins]).clip(1e-20)
    (offset, gain), _ = scipy.optimize.nnls(
        np.stack((1 / pattern_power, mean_square / pattern_power), 1), np.ones(PARTS)
    )
    return rms * float(np.clip(np.sqrt(offset / max(gain, 1e-20)), *KNEE))
