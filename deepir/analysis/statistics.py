"""Over how many px, and for how many frames, a non-uniformity is like itself.

After Saragadam et al. 2021, "How much should we jitter the camera?": the autocorrelation of the pattern says how far
the camera must move, and its temporal autocorrelation how many frames share one pattern.
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
class Statistics:
    """What is known of a pattern.

    `pattern` (h, w) in the data's units, mean zero; `correlation` (2 L + 1, 2 L + 1), its autocorrelation less its
    shading, no lag in the middle; `lengths` (x, y), how far a motion must go, px; `columns`, `rows` and `shading`,
    their shares of the variance; `in_time` (K,), the autocorrelation from frame to frame, and `holds`, for how many
    frames the pattern is the same: None where it was seen once, infinite where it never changes.
    """

    pattern: Array
    correlation: Array
    lengths: tuple[float, float]
    columns: float
    rows: float
    shading: float
    in_time: Array | None = None
    holds: float | None = None

    def at(self, shifts: Array) -> Array:
        """The autocorrelation at shifts (..., 2), (x, y) in px, by the nearest lag."""
        farthest = len(self.correlation) // 2
        x, y = np.moveaxis(np.rint(shifts).astype(int).clip(-farthest, farthest), -1, 0)
        return np.asarray(self.correlation[farthest + y, farthest + x])


def map_statistics(pattern: Array, good: Array | None = None, twin: Array | None = None) -> Statistics:
    """Statistics of a pattern (h, w) that is known once; `good` (h, w) bool: where.

    `twin` is the same pattern with other noise: products of the two are free of it.
    """
    good = np.ones(pattern.shape, bool) if good is None else good
    twin = pattern if twin is None else twin
    rough, other = (np.where(good, each - quadratic_fit(each, good), 0.0) for each in (pattern, twin))
    level = pattern[good].mean()
    total, left = (
        (a * b)[good].mean() for a, b in ((pattern - level, twin - twin[good].mean()), (rough, other))
    )
    correlation = autocorrelation(rough, other, good)
    middle = len(correlation) // 2
    along_x, along_y = correlation[middle, middle:], correlation[middle:, middle]
    rows, columns = plateau(along_x), plateau(along_y)
    lengths = (
        correlation_length((along_x - rows) / (1 - rows)),
        correlation_length((along_y - columns) / (1 - columns)),
    )
    share = max(0.0, 1 - left / total) if total > 0 else 0.0
    return Statistics(
        np.where(good, pattern - level, 0),
        correlation,
        lengths,
        columns * (1 - share),
        rows * (1 - share),
        share,
    )


def flat_statistics(frames: Array, good: Array | None = None) -> Statistics:
    """Statistics of frames (N, h, w), N > 1, of a uniform source, one after the other."""
    frames = frames.astype(np.float64)
    good = np.ones(frames.shape[1:], bool) if good is None else good
    once = map_statistics(frames[::2].mean(0), good, frames[1::2].mean(0))
    mean = frames.mean(0)
    in_time = temporal_autocorrelation(frames, good)
    return replace(
        once,
        pattern=np.where(good, mean - mean[good].mean(), 0),
        in_time=in_time,
        holds=correlation_length(in_time, STABILITY_LEVEL),
    )


def quadratic_fit(pattern: Array, good: Array) -> Array:
    """The shading: the quadratic polynomial that is nearest to a map (h, w) where it is good."""
    y, x = (np.linspace(-1, 1, side) for side in pattern.shape)
    y, x = np.broadcast_arrays(y[:, None], x)
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], -1)
    weights, *_ = np.linalg.lstsq(terms[good], pattern[good], rcond=None)
    return np.asarray(terms @ weights)


def plateau(along: Array) -> float:
    """Where an autocorrelation ends up over far lags: the share of lines, which are like themselves all along."""
    return float(np.clip(np.median(along[len(along) // 2 :]), 0, 0.99))


def correlation_length(along: Array, least: float = CORRELATION_LENGTH_LEVEL) -> float:
    """The lag at which an autocorrelation first falls below `least`, on a line between lags; infinite if none."""
    below = np.flatnonzero(along < least)
    if not below.size:
        return float("inf")
    k = int(below[0])
    return float(k) if k == 0 else k - 1 + float((along[k - 1] - least) / (along[k - 1] - along[k]))


def temporal_autocorrelation(frames: Array, good: Array) -> Array:
    """Autocorrelation of the pattern of frames (N, h, w) from frame to frame, noise left out, up to half of the frames.

    Noise is in the products of a frame with itself only: lag zero is where the line through lags one and two leads.
    """
    flat = np.stack([frame[good] - quadratic_fit(frame, good)[good] for frame in frames])
    products = flat @ flat.T / flat.shape[1]
    found = np.array([np.diagonal(products, k).mean() for k in range(1, max(2, len(frames) // 2 + 1))])
    start = 2 * found[0] - found[1] if len(found) > 1 else found[0]
    return np.concatenate([[1.0], found / start]) if start > 0 else np.ones(1)
