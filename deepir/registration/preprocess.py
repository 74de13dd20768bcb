"""What is taken out of the frames before any motion is known: gain, stripes, stuck pixels.

Frames bent so that their fixed pattern is as strong where the scene is bright as where it is dark."""

from __future__ import annotations

import numpy as np
import scipy.ndimage
import scipy.optimize
import torch
from torch import Tensor

from deepir.arrays.median import MAD
from deepir.arrays.subsample import subsample
from deepir.arrays.windows import median_filter

STUCK_THRESHOLD = 10.0  # robust standard deviations; pixels of the mean frame beyond are stuck
STRIPE_WINDOW = 31  # px across the lines; broader structure is no stripe

LOCAL_WINDOW = 7  # px; a pixel's deviation from this window's mean shows its gain and offset
FILL_WINDOW = 5  # px; first window from whose mean a bad pixel is filled
MIN_GOOD_FRACTION = 0.03  # of the window's pixels; with fewer, the next window is about twice as wide
N_FLUX_BINS = 8  # quantile bins of the pixels, from dark to bright
ASINH_SCALE_BOUNDS = (0.05, 50.0)  # root mean squares of the flux; from nearly logarithmic to nearly linear


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


def variance_stabilise(frames: Tensor, weight: Tensor) -> Tensor:
    """Frames `(N, h, w)` float64 of an even pattern, filled in where weights `(h, w)` are not one.

    Gains and offsets with variances `a` and `b` are a pattern of variance `a z^2 + b` in a flux z, and an even one in
    `asinh(z / k)`, with `k^2 = b / a` (Bartlett 1947): a logarithm where gains rule, next to nothing where offsets do.
    """
    frames = fill_bad_pixels(frames, weight == 1)
    return (frames / asinh_scale(frames.mean(0).numpy())).asinh()


def fill_bad_pixels(frames: Tensor, good: Tensor) -> Tensor:
    """Frames `(N, h, w)` float64 whose pixels that are not good are means over the least window in which some are."""
    found, unknown, window = torch.where(good, frames.double(), 0.0), ~good, FILL_WINDOW
    if not good.any():
        return found
    known, fraction = found.numpy(), good.double().numpy()
    while unknown.any():
        local_fraction = scipy.ndimage.uniform_filter(fraction, window, mode="constant")
        means = scipy.ndimage.uniform_filter(
            known, (0, window, window), mode="constant"
        ) / local_fraction.clip(1e-9)
        fillable = unknown & torch.from_numpy(local_fraction > MIN_GOOD_FRACTION)
        found, unknown, window = (
            torch.where(fillable, torch.from_numpy(means), found),
            unknown & ~fillable,
            2 * window + 1,
        )
    return found


def asinh_scale(image: np.ndarray) -> float:
    """The flux at which gains make as strong a pattern as offsets, as the bright and dark parts of an image tell."""
    local_mean = scipy.ndimage.uniform_filter(image, LOCAL_WINDOW, mode="nearest")
    rms = float(np.sqrt(np.mean(local_mean**2))) or 1.0
    bins = np.array_split(local_mean.ravel().argsort(), N_FLUX_BINS)
    flux, deviation = local_mean.ravel() / rms, np.abs(image - local_mean).ravel() / rms
    mean_square = np.array([np.mean(flux[pixels] ** 2) for pixels in bins])
    pattern_power = np.array([np.median(deviation[pixels]) ** 2 for pixels in bins]).clip(1e-20)
    (offset, gain), _ = scipy.optimize.nnls(
        np.stack((1 / pattern_power, mean_square / pattern_power), 1), np.ones(N_FLUX_BINS)
    )
    return rms * float(np.clip(np.sqrt(offset / max(gain, 1e-20)), *ASINH_SCALE_BOUNDS))
