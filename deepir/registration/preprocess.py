"""Preprocessing before any motion is known.

For residuals (`preprocess`): multiplicative patterns become additive, bad and stuck pixels are masked. For
likelihoods (`variance_stabilise`): the fixed pattern becomes equally strong in bright and in dark areas.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.ndimage
import scipy.optimize
import torch
from torch import Tensor

from deepir.arrays.statistics import MAD_TO_SIGMA, subsample
from deepir.arrays.windows import median_filter

MIN_RELATIVE_FLUX = 0.05  # of the median; smaller values are raised to it before the logarithm
MAX_NONPOSITIVE_FRACTION = 0.05  # of the samples; with more, frames are no flux and no logarithm is taken
STUCK_THRESHOLD = 10.0  # robust standard deviations; pixels of the mean frame beyond are stuck
STRIPE_WINDOW = 31  # px across the lines; broader structure is no stripe


@dataclass(frozen=True)
class StabiliserSettings:
    """How the variance of the pattern is measured as a function of the flux."""

    local_window: int = 7  # px; a pixel's deviation from this window's mean shows its gain and offset
    n_flux_bins: int = 8  # quantile bins of the pixels, from dark to bright
    #: Bounds of the asinh scale, root mean squares of the flux; from nearly logarithmic to nearly linear.
    scale_bounds: tuple[float, float] = (0.05, 50.0)


@dataclass(frozen=True)
class FillSettings:
    """The window from whose mean a bad pixel is filled."""

    window: int = 5  # px; side of the first one
    min_good_fraction: float = 0.03  # of its pixels; with fewer, the next one is about twice as wide


STABILISER = StabiliserSettings()
FILLING = FillSettings()


def preprocess(frames: Tensor, ignore: Tensor | None) -> tuple[Tensor, Tensor]:
    """Take the logarithm, mask bad and stuck pixels; of fewer than three frames, subtract stripes, too.

    Three and more frames keep their stripes, as part of the fixed pattern.

    Args:
        frames: `(N, H, W)`, any unit; NaN or infinite where a pixel is bad.
        ignore: `(H, W)` bool, True where a pixel must not be used.

    Returns:
        Frames `(N, H, W)` float32, zero where the weight is zero, and the weight `(H, W)`, zero or one.
    """
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
    """Logarithm of the frames over their median, so that gains become offsets; minus the median if not positive.

    Args:
        frames: `(N, H, W)`.
        good: `(H, W)` bool; other pixels are set to the median.
    """
    values, known = subsample(frames, good.expand_as(frames))
    known_values = values[known]
    centre = float(known_values.median())
    positive = centre > 0 and float((known_values <= 0).double().mean()) <= MAX_NONPOSITIVE_FRACTION
    y = torch.empty(frames.shape)
    for frame, out in zip(frames, y, strict=True):
        out.copy_(frame).masked_fill_(~good, centre)
        if positive:
            out.div_(centre).clamp_min_(MIN_RELATIVE_FLUX).log_()
        else:
            out.sub_(centre)
    return y


def line_pattern(image: Tensor, axis: int) -> Tensor:
    """Offset of each line along `axis`: median, along it, of the difference from a moving average across the lines.

    Args:
        image: `(H, W)`.
        axis: 0 for columns, 1 for rows.

    Returns:
        The offsets, `(1, W)` or `(H, 1)`.
    """
    moving_average = scipy.ndimage.uniform_filter1d(
        image.numpy(), STRIPE_WINDOW, axis=1 - axis, mode="nearest"
    )
    return (image - torch.from_numpy(moving_average)).median(axis, keepdim=True).values


def stuck_pixels(image: Tensor) -> Tensor:
    """Pixels `(H, W)` bool that differ from their 3 x 3 median by `STUCK_THRESHOLD` robust standard deviations."""
    deviation = (image - median_filter(image[None, None])[0, 0]).abs()
    scale = MAD_TO_SIGMA * float(subsample(deviation[None])[0].median())
    return deviation > (STUCK_THRESHOLD * scale or torch.inf)


def variance_stabilise(frames: Tensor, weight: Tensor) -> Tensor:
    """Transform the flux so that the variance of the fixed pattern does not depend on it; fill bad pixels.

    Gains of variance `a` and offsets of variance `b` are a pattern of variance `a z^2 + b` at flux `z`. In
    `asinh(z / k)`, with `k^2 = b / a`, its variance is constant: a logarithm where gains dominate, linear where offsets
    do.

    Args:
        frames: `(N, h, w)`.
        weight: `(h, w)`; pixels with a weight other than one are filled.

    Returns:
        Frames `(N, h, w)` float64.

    Source: Bartlett, The use of transformations, Biometrics 3 (1947).
    """
    frames = fill_bad_pixels(frames, weight == 1)
    return (frames / asinh_scale(frames.mean(0).numpy())).asinh()


def fill_bad_pixels(frames: Tensor, good: Tensor) -> Tensor:
    """Fill bad pixels with the mean of the good ones in the smallest window that holds enough of them.

    Args:
        frames: `(N, h, w)`.
        good: `(h, w)` bool.

    Returns:
        Frames `(N, h, w)` float64; zero if no pixel is good.
    """
    filled, unknown, window = torch.where(good, frames.double(), 0.0), ~good, FILLING.window
    if not good.any():
        return filled
    known, fraction = filled.numpy(), good.double().numpy()
    while unknown.any():
        local_fraction = scipy.ndimage.uniform_filter(fraction, window, mode="constant")
        local_sum = scipy.ndimage.uniform_filter(known, (0, window, window), mode="constant")
        means = torch.from_numpy(local_sum / local_fraction.clip(1e-9))
        fillable = unknown & torch.from_numpy(local_fraction > FILLING.min_good_fraction)
        filled, unknown, window = torch.where(fillable, means, filled), unknown & ~fillable, 2 * window + 1
    return filled


def asinh_scale(image: np.ndarray) -> float:
    """Flux at which gains and offsets contribute equally to the pattern: scale `k` of the asinh transform.

    The variance of an image about its local mean is fitted by `a z^2 + b` over bins of the flux `z`, with weights of
    one over its square, `a` and `b` not negative.

    Args:
        image: `(h, w)`, the mean of the frames.

    Returns:
        `sqrt(b / a)`, in units of the image.
    """
    local_mean = scipy.ndimage.uniform_filter(image, STABILISER.local_window, mode="nearest")
    rms = float(np.sqrt(np.mean(local_mean**2))) or 1.0
    bins = np.array_split(local_mean.ravel().argsort(), STABILISER.n_flux_bins)
    flux, deviation = local_mean.ravel() / rms, np.abs(image - local_mean).ravel() / rms
    mean_square = np.array([np.mean(flux[pixels] ** 2) for pixels in bins])
    pattern_power = np.array([np.median(deviation[pixels]) ** 2 for pixels in bins]).clip(1e-20)
    (offset, gain), _ = scipy.optimize.nnls(
        np.stack((1 / pattern_power, mean_square / pattern_power), 1), np.ones(STABILISER.n_flux_bins)
    )
    return rms * float(np.clip(np.sqrt(offset / max(gain, 1e-20)), *STABILISER.scale_bounds))
