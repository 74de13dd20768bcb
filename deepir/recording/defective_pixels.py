"""Defective pixels, and the noise of a sample."""

from __future__ import annotations

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA, mixed_deviation
from deepir.kernels.compile import parallel_for, parallel_map
from deepir.kernels.median_filter import median_filter

FRAMES_OF_NOISE = 8  # that the noise is measured in
FRAMES = 24  # of all, that are looked at
CLEAR = 10.0  # nats by which a constant is likelier than the scene, of a pixel that does not respond
#: Deviation of a pixel from the scene over time, relative to that of pixels near it, from which it is not steady.
NOISE_RATIO = 6.0
NEIGHBOURHOOD = 7  # px, side of the square of the pixels near


def noise_deviation(frames: Array) -> float:
    """Robust standard deviation of a sample's noise, from mixed second differences of frames (N, h, w)."""
    some = frames[:: max(1, len(frames) // FRAMES_OF_NOISE)]
    return max(mixed_deviation(some), float(np.finfo(np.float32).tiny))


def rounding_deviation(frame: Array) -> float:
    """Standard deviation of the rounding error of the samples of a frame (h, w); zero of a uniform one."""
    steps = np.diff(np.unique(frame[np.isfinite(frame)]))
    return float(steps.min()) / 12**0.5 if steps.size else 0.0


def defective_pixels(frames: Array, expected: Array, rounding: float = 0.0) -> Array:
    """Pixels that a constant explains better than the scene does, or that deviate from it too much.

    Args:
        frames: (N, h, w) of a scene that changes, finite.
        expected: what they should show, up to a constant of each pixel, same shape.
        rounding: standard deviation of the error of a recorded sample's rounding.

    Returns:
        (h, w) bool.
    """
    apart = frames - expected
    apart -= _median(apart)
    deviation = MAD_TO_SIGMA * _median(np.abs(apart))
    usual = np.maximum(median_filter(deviation, NEIGHBOURHOOD), max(float(np.median(deviation)), rounding))
    usual = np.maximum(usual, np.finfo(np.float32).tiny)
    constant = frames - _median(frames)
    # Deviations within half a step of the rounding tell nothing. Cauchy's likelihood: what moves by itself, and edges,
    # are in few frames.
    unexplained = [np.maximum(np.abs(each) - 3**0.5 * rounding, 0) / usual for each in (apart, constant)]
    gain = np.log1p(unexplained[0] ** 2) - np.log1p(unexplained[1] ** 2)
    return np.asarray((gain.sum(0) > CLEAR) | (deviation > NOISE_RATIO * usual))


def _median(frames: Array) -> Array:
    """Over frames (N, h, w), of each pixel."""
    found = np.empty(frames.shape[1:], frames.dtype)
    parallel_for(lambda first, last: np.median(frames[:, first:last], 0, found[first:last]), len(found))
    return found


def of_neighbours(frames: Array) -> Array:
    """Median of each sample and its neighbours, (N, h, w)."""
    return np.stack(parallel_map(lambda frame: median_filter(frame, 3), list(frames)))
