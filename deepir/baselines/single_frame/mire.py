"""Midway equalisation of columns, frame by frame."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from deepir.baselines.average import Array, average_frames, fill_invalid
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result

GAUSSIAN_WIDTHS = np.arange(0.5, 8.5, 0.5)  # px; the width with the least total variation is chosen


@register("method", "mire")
def mire(burst: Burst, config: Config) -> Result:
    """Give neighbouring columns the same histogram, then register and average.

    Each frame is corrected by itself, along columns only; single pixels are not corrected. The response of a column
    need not be linear.

    Source: Y. Tendero, S. Landeau, J. Gilles: Non-uniformity correction of infrared images by midway equalization,
    Image Processing On Line 2 (2012).
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return average_frames(burst, config, np.stack([equalise(frame) for frame in frames]))


def equalise(frame: Array) -> Array:
    """Equalise the columns of a frame (h, w) over the width with the least total variation."""
    return min((midway_equalise(frame, width) for width in GAUSSIAN_WIDTHS), key=total_variation)


def midway_equalise(frame: Array, width: float) -> Array:
    """Replace the quantiles of each column by their Gaussian mean over neighbouring columns: the midway histogram.

    Reflection at the sides keeps the mean.

    Args:
        frame: (h, w).
        width: Standard deviation of the Gaussian, px.

    Returns:
        (h, w).
    """
    order = frame.argsort(axis=0, kind="stable")
    quantiles = np.take_along_axis(frame, order, axis=0)
    shared = ndimage.gaussian_filter1d(quantiles.astype(np.float64), width, axis=1, mode="reflect")
    result = np.empty_like(shared)
    np.put_along_axis(result, order, shared, axis=0)
    return result


def total_variation(frame: Array) -> float:
    """Sum of the absolute differences of neighbours in a frame (h, w)."""
    return float(np.abs(np.diff(frame, axis=0)).sum() + np.abs(np.diff(frame, axis=1)).sum())
