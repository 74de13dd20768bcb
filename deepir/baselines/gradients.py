"""Offsets from the gradients of frames: their medians and means."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from deepir.baselines.rival import Array, estimate_offset, last_of, rival
from deepir.multiview.pattern_gradients import difference_adjoint, poisson

TV_SMOOTHING = 0.1  # smoothing of the total variation at zero, in typical gradients
TRIMMED_SHARE = 0.25  # share of the frames left out at either end of the sorted gradients


@rival("multiview_tv", estimate_offset)
def multiview_tv(frames: Array) -> Array:
    """Offset that minimises the total variation of all frames; then as `average`.

    Along x and y, the best gradient of the offset o in `sum_k |grad(y_k - o)|` is the median of the frames' gradients;
    the gradients are integrated by least squares. The gain stays one.

    Source: Barral, Arias, Davy: Fixed pattern noise removal for multi-view single-sensor infrared camera (2024).
    """
    return poisson([np.median(np.diff(frames, axis=axis), axis=0) for axis in (1, 2)])


@rival("gradient_consensus", estimate_offset)
def gradient_consensus(frames: Array) -> Array:
    """Offset whose gradients are the interquartile means of the frames' gradients; then as `average`.

    The interquartile mean stands for the paper's median: it is less noisy. The gain stays one.

    Source: Y. Weiss: Deriving intrinsic images from image sequences, ICCV (2001).
    """
    cut = int(TRIMMED_SHARE * len(frames))
    middle = slice(cut, len(frames) - cut)
    return poisson([np.sort(np.diff(frames, axis=axis), 0)[middle].mean(0, dtype=np.float64) for axis in (1, 2)])


@rival("multiview_tv_recursive", estimate_offset)
def multiview_tv_recursive(frames: Array) -> Array:
    """Offset by gradient descent on the total variation of one frame after the other, for long videos.

    Source: Barral, Arias, Davy (2024), as `multiview_tv`.
    """
    return last_of(offsets_over_time(frames))


def offsets_over_time(frames: Array) -> Iterator[Array]:
    """Offset (h, w), mean zero, after each frame of (N, h, w).

    By frame k a pixel changes by `1 / sqrt(k + 1)` typical gradients at most.
    """
    offset = np.zeros(frames.shape[1:])
    typical = float(np.median(np.abs(np.diff(frames[0], axis=-1)))) or 1.0
    for k, frame in enumerate(frames):
        slope = np.zeros_like(offset)
        for axis in (-1, -2):
            gradient = np.diff(frame - offset, axis=axis)
            slope += difference_adjoint(gradient / np.hypot(gradient, TV_SMOOTHING * typical), axis)
        offset += typical / np.sqrt(k + 1) * slope / 4
        yield offset - offset.mean()
