"""Super-resolution by shift and add."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from deepir.baselines.average import Array, average_frames, register_burst, sampling_points, to_indices
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result


@register("method", "shift_and_add")
def shift_and_add(burst: Burst, config: Config) -> Result:
    """Add registered samples on the fine grid and fill the holes; the pixels' blur stays.

    This is the maximum-likelihood estimate of the blurred scene. Gain and offset stay as they are.

    Source: M. Elad, Y. Hel-Or: A fast super-resolution reconstruction algorithm for pure translational motion and
    common space-invariant blur, IEEE Trans. Image Processing 10 (2001).
    """
    found = motion, used, _ = register_burst(burst, config)
    result = average_frames(burst, config, burst.frames, found)
    if motion is not None:
        good = (burst.valid & ~burst.bad_pixels)[used]
        result.scene = accumulate(burst.frames[used], good, motion[used].numpy(), result.scene.shape)
    return result


def accumulate(frames: Array, valid: Array, motion: Array, shape: tuple[int, ...]) -> Array:
    """Mean of the samples nearest to each point of a finer grid.

    A hole takes the mean around it, weighted by the narrowest Gaussian that reaches a sample.

    Args:
        frames: (N, h, w).
        valid: (N, h, w) bool.
        motion: (N, 3, 3), pull homographies in px about the centre.
        shape: Height and width of the finer grid.

    Returns:
        (H, W), float32.
    """
    ratio = shape[0] / frames.shape[1]
    total, count = np.zeros((2, *shape))
    for frame, good, forth in zip(frames, valid, motion, strict=True):
        row, column = (
            np.rint(to_indices(sampling_points(forth, frame.shape), shape, ratio)).astype(int).reshape(2, -1)
        )
        inside = good.ravel() & (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
        np.add.at(total, (row[inside], column[inside]), frame.ravel()[inside])
        np.add.at(count, (row[inside], column[inside]), 1)
    width = 0.5
    while not count.all():
        near, weight = ndimage.gaussian_filter(total, width), ndimage.gaussian_filter(count, width)
        reached = (count == 0) & (weight > 1e-6)
        total[reached], count[reached] = (near / weight.clip(min=1e-12))[reached], 1
        width *= 2
    return (total / count).astype(np.float32)
