"""Samples of frames as float32, and over blocks; the autocorrelation of maps, and their outliers."""

from __future__ import annotations

import numpy as np
from scipy import fft

from deepir.arrays import Array

MAD_TO_SIGMA = 1.4826  # standard deviation of a Gaussian, per median absolute deviation
CHI_SQUARED_MEDIAN = MAD_TO_SIGMA**-2  # of one degree of freedom
MAX_LAG = 50  # largest lag along an axis, px
OUTLIER_DEVIATION = 7.0  # robust standard deviations of the pattern: beyond, a pixel is no part of it
ISOLATION = 4.0  # ratio of a defective pixel's residual to its neighbourhood's


def autocorrelation(pattern: Array, second: Array, good: Array) -> Array:
    """Normalised correlation of two maps as a function of the lag, by fast Fourier transforms.

    Args:
        pattern: (h, w), zero where not good.
        second: The second map, same shape; `pattern` itself for an autocorrelation.
        good: Pixels that count, (h, w), bool.

    Returns:
        Correlations (2 l + 1, 2 l + 1), one at the centre; l is a quarter of the shorter side, at most `MAX_LAG`.
    """
    max_lag = min(MAX_LAG, min(pattern.shape) // 4)
    size = [fft.next_fast_len(side + max_lag) for side in pattern.shape]
    one, other, mask = (fft.rfft2(each, size) for each in (pattern, second, good.astype(float)))
    products, pairs = (fft.irfft2(a.conj() * b, size) for a, b in ((one, other), (mask, mask)))
    lags = np.arange(-max_lag, max_lag + 1)
    found = (products / pairs.clip(min=1))[np.ix_(lags, lags)]
    found = (found + found[::-1, ::-1]) / 2
    return np.asarray(found / max(found[max_lag, max_lag], 1e-300))


def as_float32(frame: Array) -> Array:
    """Samples (..., h, w) as a float32 copy: exact up to 24 bits, infinite beyond its range, NaN where masked."""
    with np.errstate(over="ignore"):
        samples: Array = np.ma.filled(frame.astype(np.float32, order="C"), np.nan)
    return samples


def mixed_deviation(frames: Array) -> float:
    """Robust standard deviation of a sample's noise, from mixed second differences of frames (N, h, w); NaN of none."""
    with np.errstate(invalid="ignore"):  # of infinite samples
        mixed = np.abs(frames[:, 1:, 1:] - frames[:, :-1, 1:] - frames[:, 1:, :-1] + frames[:, :-1, :-1])
    known = mixed[np.isfinite(mixed)]
    return MAD_TO_SIGMA * float(np.median(known)) / 2 if known.size else float("nan")


def block_sums(values: Array, block: int) -> Array:
    """Sums (..., h // block, w // block), float64, of values (..., h, w) over blocks of px, from the first on."""
    height, width = (side // block for side in values.shape[-2:])
    cut = values[..., : height * block, : width * block]
    rows = cut.reshape(*values.shape[:-2], height, block, width * block).sum(-2, dtype=float)
    return np.asarray(rows.reshape(*rows.shape[:-1], width, block).sum(-1))


def block_means(frames: Array, usable: Array, block: int) -> Array:
    """Means (N, h // block, w // block), float64, of the usable samples of frames (N, h, w) over blocks of px.

    `usable`, bool, says which samples count; where none of a block does, the median of the frame's takes its place.
    """
    means = np.empty((len(frames), *(side // block for side in frames.shape[1:])))
    for mean, frame, good in zip(means, frames, usable, strict=True):
        with np.errstate(invalid="ignore"):
            mean[:] = block_sums(np.where(good, frame, 0), block) / block_sums(good, block)
        empty = np.isnan(mean)
        if empty.any():
            mean[empty] = np.median(frame[good]) if good.any() else 0.0
    return means


def pattern_outliers(pattern: Array, known: Array) -> Array:
    """Pixels whose pattern (h, w) is far from what their neighbours' lets expect, bool; columns and rows may differ."""
    from deepir.kernels.median_filter import median_filter

    apart = pattern
    for axis in (0, 1):
        lines = np.where(known, apart, np.median(apart[known])) if known.any() else apart
        apart = apart - np.quantile(lines, 0.5, axis=axis, method="lower", keepdims=True)
    apart = np.abs(apart - median_filter(apart, 3))
    differ = apart[known & (apart > 0)]
    if differ.size < apart.size / 4:  # most pixels are exactly alike: nothing to compare with
        return np.zeros_like(known)
    limit = OUTLIER_DEVIATION * MAD_TO_SIGMA * np.quantile(differ, 0.5, method="lower")
    return np.asarray(known & (apart > limit) & (apart > ISOLATION * median_filter(apart, 3)))
