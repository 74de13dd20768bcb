"""Gain and bias by regression on the registered average."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from deepir.baselines.average import (
    Array,
    correct_and_average,
    fill_invalid,
    register_burst,
    registered_mean,
    sampling_points,
    to_indices,
)
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result


@register("method", "hardie2000")
def hardie2000(burst: Burst, config: Config) -> Result:
    """Fit each pixel's gain and bias to the registered average of the frames, by least squares.

    The scene is averaged along the trajectories of the motion; a line `y = gain z + bias` is fitted to the samples of
    each pixel. There is no prior: three frames leave one degree of freedom. The registration is deepir's.

    Source: R. C. Hardie, M. M. Hayat, E. Armstrong, B. Yasuda: Scene-based nonuniformity correction with video
    sequences and registration, Applied Optics 39 (2000).
    """
    found = motion, used, _ = register_burst(burst, config)
    frames, valid = burst.frames[used], (burst.valid & ~burst.bad_pixels)[used]
    seen = frames.mean(0, keepdims=True).repeat(len(frames), 0)
    if motion is not None:
        seen = trajectory_means(frames, valid, motion[used].numpy())
    return correct_and_average(burst, config, *fit_lines(seen, fill_invalid(frames, valid)), found)


def trajectory_means(frames: Array, valid: Array, motion: Array) -> Array:
    """The scene at each sample: the mean of all frames along the trajectory through it.

    Args:
        frames: (N, h, w).
        valid: (N, h, w) bool.
        motion: (N, 3, 3), pull homographies in px about the centre.

    Returns:
        (N, h, w).
    """
    points = np.stack([sampling_points(each, frames.shape[1:]) for each in motion])
    outside = np.abs(points).max(axis=(0, 2, 3)) - (np.array(frames.shape[1:]) - 1) / 2
    margin = [(0, 0), *((rim, rim) for rim in np.ceil(outside + 1e-6).astype(int))]
    mean = registered_mean(np.pad(frames, margin), np.pad(valid, margin), motion).numpy()
    return np.stack(
        [
            ndimage.map_coordinates(mean, to_indices(each, mean.shape), order=3, mode="mirror")
            for each in points
        ]
    )


def fit_lines(scene: Array, frames: Array) -> tuple[Array, Array]:
    """Fit `frames = gain * scene + bias` to the samples of each pixel.

    Args:
        scene: (N, h, w).
        frames: (N, h, w).

    Returns:
        Gain and bias, (h, w); gain one where all scene values agree.
    """
    x, y = scene.astype(np.float64), frames.astype(np.float64)
    x_mean, y_mean = x.mean(0), y.mean(0)
    variance = ((x - x_mean) ** 2).sum(0)
    covariance = ((x - x_mean) * (y - y_mean)).sum(0)
    gain = np.divide(covariance, variance, out=np.ones_like(variance), where=variance > 0)
    return gain, y_mean - gain * x_mean
