"""The noise of recorded samples, without a model of the scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.arrays.statistics import MAD_TO_SIGMA

Array = np.ndarray[Any, Any]

FRAMES = 8  # that the noise is measured in


def noise_deviation(frames: Array) -> float:
    """Robust standard deviation of a sample's noise, from mixed second differences of frames (N, h, w)."""
    some = frames[:: max(1, len(frames) // FRAMES)]
    mixed = some[:, 1:, 1:] - some[:, :-1, 1:] - some[:, 1:, :-1] + some[:, :-1, :-1]
    return max(MAD_TO_SIGMA * float(np.nanmedian(np.abs(mixed))) / 2, float(np.finfo(np.float32).tiny))


def rounding_deviation(frame: Array) -> float:
    """Standard deviation of the rounding error of the samples of a frame (h, w); zero of a uniform one."""
    steps = np.diff(np.unique(frame[np.isfinite(frame)]))
    return float(steps.min()) / 12**0.5 if steps.size else 0.0
