"""Offset from a robust mean of the frames' gradients (intrinsic images)."""

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
    """Offset whose gradients are the interquartile means of the frames' gradients; then as `average`.

    The interquartile mean stands for the paper's median: it is less noisy. The gain stays one.

    Source: Y. Weiss: Deriving intrinsic images from image sequences, ICCV (2001).
    """
    offset = poisson([interquartile_mean(np.diff(burst.frames, axis=axis)) for axis in (-1, -2)])
    offset = offset - offset[~burst.bad_pixels].mean()
    frames = (burst.frames - offset).astype(np.float32)
    result: Result = average(dataclasses.replace(burst, frames=frames), config)
    result.offset = offset.astype(np.float32)
    return result


def interquartile_mean(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of values (N, ...) along the first axis."""
    count = len(values)
    cut = int(TRIMMED_SHARE * count)
    return np.asarray(np.sort(values, 0)[cut : count - cut].mean(0, dtype=np.float64))
