"""Midway equalisation of columns, frame by frame: no motion is needed."""

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

    Y. Tendero, S. Landeau, J. Gilles: Non-uniformity correction of infrared images by midway equalization, Image
    Processing On Line 2 (2012). Single frame, columns only, blind to pixels; a column's response need not be linear.
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return average_frames(burst, config, np.stack([equalise(frame) for frame in frames]))


def equalise(frame: Array) -> Array:
    """A frame (h, w) with columns equalised over the width at which its total variation is least."""
    return min((midway_equalise(frame, width) for width in GAUSSIAN_WIDTHS), key=total_variation)


def midway_equalise(frame: Array, width: float) -> Array:
    """Replace each column's quantiles by their mean over the columns about it, weighted by a Gaussian of `width` px.

    Averages of inverse cumulative histograms are the midway histogram. Reflection at the sides keeps the mean.
    """
    order = frame.argsort(axis=0, kind="stable")
    quantiles = np.take_along_axis(frame, order, axis=0)
    shared = ndimage.gaussian_filter1d(quantiles.astype(np.float64), width, axis=1, mode="reflect")
    result = np.empty_like(shared)
    np.put_along_axis(result, order, shared, axis=0)
    return result


def total_variation(frame: Array) -> float:
    """Sum of absolute differences of neighbours."""
    return float(np.abs(np.diff(frame, axis=0)).sum() + np.abs(np.diff(frame, axis=1)).sum())
