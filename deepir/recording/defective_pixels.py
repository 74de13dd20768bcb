"""Pixels of a camera that do not show the scene as their neighbours do, from frames of a moving scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.median_filter import median_filter

Array = np.ndarray[Any, Any]

FRAMES = 24  # of all, that are looked at
#: Slope of a pixel over the median of its surroundings, at most, of one that does not respond; and the standard errors
#: by which it is below that.
MUTE_SLOPE, SIGNIFICANCE = 0.5, 4.0
#: Deviation of a pixel from its surroundings over time, relative to that of pixels near it, from which it is noisy.
NOISE_RATIO = 6.0
#: Offset of a pixel from its surroundings, in robust standard deviations of all pixels', from which it is defective.
OFFSET_DEVIATIONS = 10.0
NEIGHBOURHOOD = 7  # px, side of the square of the pixels near


def defective_pixels(frames: Array, usable: Array, offset: Array, rounding: float = 0.0) -> Array:
    """Pixels that do not follow their surroundings from frame to frame, flicker, or are far off.

    Args:
        frames: (N, h, w) of a scene that changes, finite.
        usable: which samples count, same shape.
        offset: fixed pattern of the frames, (h, w).
        rounding: standard deviation of the error of a recorded sample's rounding. In corrected recordings of 8 bits
            most pixels have no other.

    Returns:
        (h, w) bool.
    """
    chosen = slice(None, None, max(1, len(frames) // FRAMES))
    some = frames[chosen] - offset
    around = np.stack([median_filter(frame, 3) for frame in some])
    some = np.where(usable[chosen], some, around)
    level = np.median(some, axis=(1, 2), keepdims=True)
    x, y = around - level, some - level
    x, y = x - x.mean(0), y - y.mean(0)
    power = np.maximum((x * x).sum(0), np.finfo(np.float32).tiny)
    slope = (x * y).sum(0) / power
    error = np.sqrt(((y - slope * x) ** 2).sum(0) / max(len(some) - 2, 1) / power)
    is_mute = slope + SIGNIFICANCE * error < MUTE_SLOPE
    apart = some - around
    noise = np.median(np.abs(apart - np.median(apart, axis=0)), axis=0)
    usual = np.maximum(median_filter(noise, NEIGHBOURHOOD), max(np.median(noise), rounding))
    detail = np.abs(offset - median_filter(offset, 3))
    is_far = detail > OFFSET_DEVIATIONS * max(MAD_TO_SIGMA * np.median(detail), rounding)
    return np.asarray(is_mute | is_far | (noise > NOISE_RATIO * usual) | ~usable.any(0))
