"""Correlation lengths and stability of a fixed pattern.

The autocorrelation of the pattern gives the motion that a burst needs, its temporal autocorrelation the number of
frames that share one pattern.

Source: Saragadam et al. 2021, "How much should we jitter the camera?".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepir.arrays.autocorrelation import autocorrelation

Array = np.ndarray[Any, Any]

#: Autocorrelation at which the correlation length is read; Saragadam et al. 2021.
CORRELATION_LENGTH_LEVEL = 0.1
#: Temporal autocorrelation down to which a pattern is unchanged; Saragadam et al. 2021.
STABILITY_LEVEL = 0.8
MIN_REPORTED_SHARE = 0.05  # share of the pattern's variance from which a component is reported


@dataclass(frozen=True)
class PatternStatistics:
    """Statistics of a fixed pattern.

    Attributes:
        pattern: (h, w), in the data's units, mean zero.
        correlation: (2 L + 1, 2 L + 1), autocorrelation of the pattern without its shading; lag zero in the middle.
        lengths: Correlation lengths along x and y, px.
        columns: Share of the variance that is constant along columns.
        rows: Share of the variance that is constant along rows.
        shading: Share of the variance that is a quadratic polynomial.
        temporal: (K,), autocorrelation from frame to frame; None if the pattern was seen once.
        stable_frames: Frames for which the pattern is unchanged, infinite if it never changes; None as above.
    """

    pattern: Array
    correlation: Array
    lengths: tuple[float, float]
    columns: float
    rows: float
    shading: float
    temporal: Array | None = None
    stable_frames: float | None = None

    def autocorrelation_at(self, shifts: Array) -> Array:
        """Autocorrelation at shifts (..., 2), x and y in px, by the nearest lag."""
        farthest = len(self.correlation) // 2
        x, y = np.moveaxis(np.rint(shifts).astype(int).clip(-farthest, farthest), -1, 0)
        return np.asarray(self.correlation[farthest + y, farthest + x])


def map_statistics(
    pattern: Array, good: Array | None = None, repeat: Array | None = None
) -> PatternStatistics:
    """Statistics of a pattern that was seen once.

    Args:
        pattern: (h, w), in the data's units.
        good: (h, w) bool, usable pixels; None: all.
        repeat: (h, w), the same pattern with independent noise; products with it are free of noise.
    """
    good = np.ones(pattern.shape, bool) if good is None else good
    repeat = pattern if repeat is None else repeat
    rough, other = (np.where(good, each - quadratic_fit(each, good), 0.0) for each in (pattern, repeat))
    level = pattern[good].mean()
    total, without_shading = (
        (a * b)[good].mean() for a, b in ((pattern - level, repeat - repeat[good].mean()), (rough, other))
    )
    correlation = autocorrelation(rough, other, good)
    middle = len(correlation) // 2
    along_x, along_y = correlation[middle, middle:], correlation[middle:, middle]
    rows, columns = plateau(along_x), plateau(along_y)
    lengths = (
        correlation_length((along_x - rows) / (1 - rows)),
        correlation_length((along_y - columns) / (1 - columns)),
    )
    shading = max(0.0, 1 - without_shading / total) if total > 0 else 0.0
    return PatternStatistics(
        np.where(good, pattern - level, 0),
        correlation,
        lengths,
        columns * (1 - shading),
        rows * (1 - shading),
        shading,
    )


def flat_statistics(frames: Array, good: Array | None = None) -> PatternStatistics:
    """Statistics of successive frames of a uniform source.

    Args:
        frames: (N, h, w), N > 1, in the data's units.
        good: (h, w) bool, usable pixels; None: all.
    """
    frames = frames.astype(np.float64)
    good = np.ones(frames.shape[1:], bool) if good is None else good
    once = map_statistics(frames[::2].mean(0), good, frames[1::2].mean(0))
    mean = frames.mean(0)
    temporal = temporal_autocorrelation(frames, good)
    return replace(
        once,
        pattern=np.where(good, mean - mean[good].mean(), 0),
        temporal=temporal,
        stable_frames=correlation_length(temporal, STABILITY_LEVEL),
    )


def quadratic_fit(pattern: Array, good: Array) -> Array:
    """Quadratic polynomial (h, w) fitted to a map (h, w) by least squares where `good` (h, w)."""
    y, x = (np.linspace(-1, 1, side) for side in pattern.shape)
    y, x = np.broadcast_arrays(y[:, None], x)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)
    weights, *_ = np.linalg.lstsq(terms[good], pattern[good], rcond=None)
    return np.asarray(terms @ weights)


def plateau(along: Array) -> float:
    """Autocorrelation (L + 1,) at large lags: the share of lines, which are fully correlated along themselves."""
    return float(np.clip(np.median(along[len(along) // 2 :]), 0, 0.99))


def correlation_length(along: Array, level: float = CORRELATION_LENGTH_LEVEL) -> float:
    """Lag at which an autocorrelation first falls below a level, by linear interpolation.

    Args:
        along: (L + 1,), from lag zero on.
        level: The level.

    Returns:
        The lag; infinite if the autocorrelation stays above.
    """
    below = np.flatnonzero(along < level)
    if not below.size:
        return float("inf")
    k = int(below[0])
    return float(k) if k == 0 else k - 1 + float((along[k - 1] - level) / (along[k - 1] - along[k]))


def temporal_autocorrelation(frames: Array, good: Array) -> Array:
    """Autocorrelation of the pattern from frame to frame, free of noise.

    Noise is in the products of a frame with itself only: lag zero is extrapolated from lags one and two.

    Args:
        frames: (N, h, w), of a uniform source.
        good: (h, w) bool, usable pixels.

    Returns:
        (K,), from lag zero to half the number of frames.
    """
    flat = np.stack([frame[good] - quadratic_fit(frame, good)[good] for frame in frames])
    products = flat @ flat.T / flat.shape[1]
    found = np.array([np.diagonal(products, k).mean() for k in range(1, max(2, len(frames) // 2 + 1))])
    start = 2 * found[0] - found[1] if len(found) > 1 else found[0]
    return np.concatenate([[1.0], found / start]) if start > 0 else np.ones(1)
