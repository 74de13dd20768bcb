"""Robust statistics of large arrays, and subsampling."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepir.kernels.dispatch import is_compiled

#: Standard deviation of a Gaussian, per median absolute deviation.
MAD_TO_SIGMA = 1.4826
CHI_SQUARED_MEDIAN = MAD_TO_SIGMA**-2  # of one degree of freedom
#: Numbers from which the compiled median is faster than that of torch.
MIN_SIZE_OF_COMPILED_MEDIAN = 5_000
#: Samples of a frame that suffice for a median or a mean.
MAX_SAMPLES_PER_FRAME = 40_000


def median(values: Tensor) -> float:
    """Median; the lower of the two middle values, as in torch.

    Args:
        values: Of any shape, without NaN.

    Returns:
        The median; NaN for no values.
    """
    if (
        not is_compiled(values)
        or values.dtype != torch.float32
        or values.numel() < MIN_SIZE_OF_COMPILED_MEDIAN
    ):
        return float(values.median())
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.median import median as median_of_bits

    found = torch.empty(1)
    parallel_for(median_of_bits, 1, values.contiguous().flatten().view(torch.int32), found.view(torch.int32))
    return float(found)


def robust_std(values: Tensor) -> float:
    """Standard deviation from the median absolute deviation about the median."""
    return MAD_TO_SIGMA * median((values - median(values)).abs())


def subsample(*frames: Tensor, max_samples: int = MAX_SAMPLES_PER_FRAME) -> list[Tensor]:
    """The same regularly spaced samples of several stacks of frames.

    Args:
        frames: Stacks, (N, C, h, w) each.
        max_samples: About how many samples of a frame are kept.

    Returns:
        For each stack its samples, (N, m), from all columns of the image.
    """
    *_, height, width = frames[0].shape
    stride = max(1, height * width // max_samples)
    while math.gcd(stride, width) > 1:  # a common factor would visit the same columns only
        stride += 1
    return [each.flatten(1)[:, ::stride] for each in frames]


def masked_values(values: Tensor, mask: Tensor) -> Tensor:
    """`values[mask]`, (K,); by numpy on the CPU, which is ten times as fast as torch."""
    if not is_compiled(values):
        return values[mask]
    return torch.from_numpy(values.numpy()[mask.numpy()])
