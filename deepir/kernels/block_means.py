# mypy: disable-error-code="no-untyped-def"
"""Means over blocks of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.kernels.compile import compiled, parallel_for

Array = np.ndarray[Any, Any]


def block_means(frames: Array, usable: Array, factor: int) -> Array:
    """Means of the usable samples of `factor` x `factor` px, from the first on.

    Args:
        frames: (N, h, w), floating point.
        usable: (N, h, w) bool, which samples count.
        factor: side of a block, px.

    Returns:
        (N, h // factor, w // factor), float64; the median of a frame's usable samples where a block has none.
    """
    means = np.empty((len(frames), *(side // factor for side in frames.shape[1:])))
    parallel_for(_block_means, len(frames), frames, usable, factor, means)
    for mean, frame, good in zip(means, frames, usable, strict=True):
        empty = np.isnan(mean)
        if empty.any():
            mean[empty] = np.median(frame[good]) if good.any() else 0.0
    return means


@compiled
def _block_means(first, last, frames, usable, factor, means):
    """Means of frames `first` to `last`; NaN where no sample of a block is usable."""
    height, width = means.shape[1:]
    for k in range(first, last):
        for i in range(height):
            sums, counts = np.zeros(width), np.zeros(width)
            for row in range(i * factor, (i + 1) * factor):
                for j in range(width):
                    for column in range(j * factor, (j + 1) * factor):
                        good = usable[k, row, column]
                        sums[j] += frames[k, row, column] if good else 0.0
                        counts[j] += good
            for j in range(width):  # to divide arrays takes ten times as long to compile
                means[k, i, j] = sums[j] / counts[j]
