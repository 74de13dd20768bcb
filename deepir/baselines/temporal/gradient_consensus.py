"""Intrinsic images: an offset from the median of derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np

from deepir.baselines.average import average
from deepir.burst import Burst
from deepir.config import Config
from deepir.multiview.pattern import poisson
from deepir.registry import register
from deepir.result import Result

TRIMMED_SHARE = 0.25  # share of the frames left out at either end of the sorted gradients


@register("method", "gradient_consensus")
def gradient_consensus(burst: Burst, config: Config) -> Result:
    """The offset whose gradients are the interquartile means of those of the frames; then as `average`.

    After Weiss (2001), "Deriving intrinsic images from image sequences". The mean of the middle half of the derivatives
    stands for their median: it is less noisy. No gain.
    """
    offset = poisson([interquartile_mean(np.diff(burst.frames, axis=axis)) for axis in (-1, -2)])
    offset = offset - offset[~burst.bad_pixels].mean()
    frames = (burst.frames - offset).astype(np.float32)
    result: Result = average(dataclasses.replace(burst, frames=frames), config)
    result.offset = offset.astype(np.float32)
    return result


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """The mean of the middle half along the first axis."""
    count = len(values)
    cut = int(TRIMMED_SHARE * count)
    return np.asarray(np.sort(values, 0)[cut : count - cut].mean(0, dtype=np.float64))
