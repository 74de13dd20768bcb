"""Residual fixed pattern of a corrected recording."""

from __future__ import annotations

import numpy as np

from deepir.errors import DataError
from deepir.simulate.recording.recording import Recording


def residual_pattern(corrected: np.ndarray, recording: Recording) -> float:
    """Root mean square over good pixels of `residual_map`.

    Args:
        corrected: (N, H, W), in the units of the recording's frames.
        recording: With its truth.

    Returns:
        In sigmas of the noise of a sample (`truth.noise`).

    Raises:
        DataError: The shapes differ, or all frames are of the shutter.
    """
    return float(np.sqrt(np.nanmean(residual_map(corrected, recording) ** 2)))


def residual_map(corrected: np.ndarray, recording: Recording) -> np.ndarray:
    """Temporal mean of the error of a correction.

    The level of each frame is free and, with an automatic gain control, its gain too: both by least squares. Bad
    pixels, frames of the shutter, and samples at an end of 8 bits are left out.

    Args:
        corrected: (N, H, W), in the units of the recording's frames.
        recording: With its truth.

    Returns:
        (H, W), in sigmas of the noise of a sample (`truth.noise`), mean zero; NaN without a sample.

    Raises:
        DataError: The shapes differ, or all frames are of the shutter.
    """
    truth = recording.truth
    if corrected.shape != recording.frames.shape:
        raise DataError(f"corrected: frames of {recording.frames.shape} are needed, not of {corrected.shape}")
    if truth.shutter.all():
        raise DataError("recording: all frames are of the shutter")
    total, count = np.zeros((2, *truth.gain.shape))
    for k in np.flatnonzero(~truth.shutter):
        valid = ~truth.bad_pixels
        if recording.settings.agc:
            valid = valid & (recording.frames[k] > 0) & (recording.frames[k] < 255)
        frame, scene = corrected[k].astype(float), truth.scene[k].astype(float)
        gain = 1.0
        if recording.settings.agc:
            from_mean = scene[valid] - scene[valid].mean()
            gain = float(from_mean @ frame[valid] / (from_mean @ from_mean))
        error = frame / gain - scene
        total[valid] += error[valid] - error[valid].mean()
        count[valid] += 1
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.asarray((mean - np.nanmean(mean)) / truth.noise)
