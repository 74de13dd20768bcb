"""Offset from the gradients of many unregistered frames: their medians, or means."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from deepir.baselines.average import average
from deepir.baselines.online import last_of
from deepir.burst import Burst
from deepir.config import Config
from deepir.multiview.pattern import poisson
from deepir.registry import register
from deepir.result import Result

STEP_LENGTH = 1.0  # largest change of a pixel by the first frame, in typical gradients
TV_SMOOTHING = 0.1  # smoothing of the total variation at zero, in typical gradients


@register("method", "multiview_tv")
def multiview_tv(burst: Burst, config: Config) -> Result:
    """Offset that minimises the total variation of all frames; then as `average`.

    Along x and y, the best gradient of the offset o in `sum_k |grad(y_k - o)|` is the median of the frames' gradients;
    the gradients are integrated by least squares. The gain stays one.

    Source: Barral, Arias, Davy: Fixed pattern noise removal for multi-view single-sensor infrared camera (2024).
    """
    return _corrected(burst, config, median_offset(burst.frames))


@register("method", "multiview_tv_recursive")
def multiview_tv_recursive(burst: Burst, config: Config) -> Result:
    """Offset by gradient descent on the total variation of one frame after the other, for long videos.

    Source: Barral, Arias, Davy (2024), as `multiview_tv`.
    """
    return _corrected(burst, config, recursive_offset(burst.frames))


def median_offset(frames: np.ndarray) -> np.ndarray:
    """Offset (h, w), mean zero, whose gradients are nearest to the medians of those of frames (N, h, w)."""
    return poisson([np.median(np.diff(frames, axis=axis), axis=0) for axis in (-1, -2)])


def recursive_offset(frames: np.ndarray) -> np.ndarray:
    """Offset (h, w), mean zero, after one step for each frame of (N, h, w), of length `1 / sqrt(k + 1)`."""
    return last_of(offsets_over_time(frames))


def offsets_over_time(frames: np.ndarray) -> Iterator[np.ndarray]:
    """Offset (h, w) after each frame of (N, h, w), as in `recursive_offset`."""
    offset = np.zeros(frames.shape[1:])
    typical = float(np.median(np.abs(np.diff(frames[0], axis=-1)))) or 1.0
    for k, frame in enumerate(frames):
        slope = np.zeros_like(offset)
        for axis in (-1, -2):
            gradient = np.diff(frame - offset, axis=axis)
            slope += _adjoint(gradient / np.hypot(gradient, TV_SMOOTHING * typical), axis)
        offset += STEP_LENGTH * typical / np.sqrt(k + 1) * slope / 4
        yield offset - offset.mean()


def _adjoint(edges: np.ndarray, axis: int) -> np.ndarray:
    """The adjoint of differences along an axis."""
    return -np.diff(edges, axis=axis, prepend=0, append=0)


def _corrected(burst: Burst, config: Config, offset: np.ndarray) -> Result:
    offset = offset - offset[~burst.bad_pixels].mean()
    frames = (burst.frames - offset).astype(np.float32)
    result: Result = average(dataclasses.replace(burst, frames=frames), config)
    result.offset = offset.astype(np.float32)
    return result


TRIMMED_SHARE = 0.25  # share of the frames left out at either end of the sorted gradients


@register("method", "gradient_consensus")
def gradient_consensus(burst: Burst, config: Config) -> Result:
    """Offset whose gradients are the interquartile means of the frames' gradients; then as `average`.

    The interquartile mean stands for the paper's median: it is less noisy. The gain stays one.

    Source: Y. Weiss: Deriving intrinsic images from image sequences, ICCV (2001).
    """
    offset = poisson([interquartile_mean(np.diff(burst.frames, axis=axis)) for axis in (-1, -2)])
    return _corrected(burst, config, offset)


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of values (N, ...) along the first axis."""
    count = len(values)
    cut = int(TRIMMED_SHARE * count)
    return np.asarray(np.sort(values, 0)[cut : count - cut].mean(0, dtype=np.float64))
