"""Constant statistics: all pixels see the same mean and deviation in the long run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepir.baselines.average import Array, correct_and_average, fill_invalid
from deepir.baselines.online import last_of
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result


@register("method", "constant_statistics")
def constant_statistics(burst: Burst, config: Config) -> Result:
    """Give all pixels the same mean and deviation over time, then register and average.

    The method needs hundreds of frames that cross the whole scene; in a short burst the scene remains in the pattern.

    Source: J. G. Harris, Y.-M. Chiang: Nonuniformity correction of infrared image sequences using the
    constant-statistics constraint, IEEE Trans. Image Processing 8 (1999).
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return correct_and_average(burst, config, *equalised_statistics(frames))


def equalised_statistics(frames: Array) -> tuple[Array, Array]:
    """Gain and offset (h, w) that give all pixels of frames (N, h, w) the same mean and deviation."""
    return equalised(*last_of(running_statistics(frames)))


def equalised(mean: Array, deviation: Array) -> tuple[Array, Array]:
    """Gain and offset (h, w) that give all pixels the same of these."""
    deviation = np.maximum(deviation, np.finfo(np.float32).tiny)  # dead pixels have none
    gain = deviation / deviation.mean()
    return gain, mean - gain * mean.mean()


def running_statistics(frames: Array) -> Iterator[tuple[Array, Array]]:
    """Mean and mean absolute deviation of each pixel, (h, w), after each of frames (N, h, w): the paper's recursion."""
    mean, deviation = frames[0].astype(np.float64), np.zeros(frames.shape[1:])
    yield mean, deviation
    for n, frame in enumerate(frames[1:], 2):
        mean = mean + (frame - mean) / n
        deviation = deviation + (np.abs(frame - mean) - deviation) / n
        yield mean, deviation
