"""Gain and offset of pixels from their statistics over time, or over the registered scene."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import ndimage
from scipy.fft import dctn, idctn

from deepir.baselines.rival import (
    Array,
    estimate_pattern,
    estimate_registered_pattern,
    fill_invalid,
    last_of,
    registered_mean,
    rival,
    sampling_points,
    to_indices,
)

FRAMES = 64  # frames of a long recording that are used, evenly spread
REWEIGHTINGS = 3
ITERATIONS = 60  # of each reweighting, at most
TOLERANCE = 1e-4  # rest that the model leaves, relative to the frames, at which the iterations end
PENALTY_GROWTH = 1.5  # factor of the quadratic penalty from an iteration to the next
#: Weights of the sparse spectra: of the flat field over the mean frame's spectrum, of the dark field over the former.
FLAT_WEIGHT, DARK_WEIGHT = 1 / 800, 0.2
REWEIGHTING_FLOOR = 0.1  # smallest scaled residual that a weight is the inverse of


@rival("constant_statistics", estimate_pattern)
def constant_statistics(frames: Array) -> tuple[Array, Array]:
    """Give all pixels the same mean and deviation over time, then register and average.

    The method needs hundreds of frames that cross the whole scene; in a short burst the scene remains in the pattern.

    Source: J. G. Harris, Y.-M. Chiang: Nonuniformity correction of infrared image sequences using the
    constant-statistics constraint, IEEE Trans. Image Processing 8 (1999).
    """
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


@rival("basic", estimate_pattern)
def basic(frames: Array) -> tuple[Array, Array]:
    """Flat field and dark field with sparse spectra under a sparse scene (BaSiC); then register and average.

    The model is `y_k = b_k flat + dark + r_k`, with as small a sum of `|w r|` and of the fields' cosine spectra as
    can be. The weights w are inverse residuals, found in turn with the rest. As in the authors' program the values of
    each pixel are sorted first, which makes the scenes alike.

    Args:
        frames: (N, h, w).

    Returns:
        Flat field (mean one) and dark field (mean zero), (h, w).

    Source: T. Peng, K. Thorn, T. Schroeder, L. Wang, F. J. Theis, C. Marr, N. Navab: A BaSiC tool for background and
    shading correction of optical microscopy images, Nature Communications 8 (2017).
    """
    some = np.unique(np.linspace(0, len(frames) - 1, min(FRAMES, len(frames))).astype(int))
    values = np.sort(frames[some].astype(np.float64), axis=0)
    scale = float(np.abs(values).mean()) or 1.0
    values /= scale
    weights = np.ones_like(values)
    for _ in range(REWEIGHTINGS):
        flat, dark, rest = _decomposed(values, weights)
        weights = 1 / (np.abs(rest) / max(float(np.abs(rest).mean()), 1e-12) + REWEIGHTING_FLOOR)
        weights /= weights.mean()
    return flat, scale * (dark - dark.mean())


def _decomposed(values: Array, weights: Array) -> tuple[Array, Array, Array]:
    """Flat field, dark field and sparse rest, by the alternating directions of an augmented Lagrangian."""
    mean = values.mean(0)
    of_flat = FLAT_WEIGHT * float(np.abs(dctn(mean, norm="ortho")).sum())
    of_dark = DARK_WEIGHT * of_flat
    flat, dark = np.full_like(mean, mean.mean()), np.zeros_like(mean)
    rest, multiplier = np.zeros_like(values), np.zeros_like(values)
    levels = values.mean((1, 2))
    penalty, size = 1 / float(np.abs(values - mean).mean() or 1.0), float(np.linalg.norm(values))
    for _ in range(ITERATIONS):
        target = values - rest + multiplier / penalty
        levels = np.maximum((target - dark).mean((1, 2)) / flat.mean(), 0)
        power = float(levels @ levels) or 1.0
        flat = _sparse_spectrum(
            np.tensordot(levels, target - dark, 1) / power, of_flat * len(values) / (penalty * power)
        )
        dark = (target - levels[:, None, None] * flat).mean(0)
        dark = _shrunk(_sparse_spectrum(dark - dark.mean(), of_dark / penalty), of_dark / penalty)
        model = levels[:, None, None] * flat + dark
        rest = _shrunk(values - model + multiplier / penalty, weights / penalty)
        left = values - model - rest
        multiplier += penalty * left
        penalty *= PENALTY_GROWTH
        if np.linalg.norm(left) < TOLERANCE * size:
            break
    return flat / flat.mean(), dark, rest


def _sparse_spectrum(field: Array, threshold: float) -> Array:
    return np.asarray(idctn(_shrunk(dctn(field, norm="ortho"), threshold), norm="ortho"))


def _shrunk(values: Array, threshold: Array | float) -> Array:
    return np.asarray(np.sign(values) * np.maximum(np.abs(values) - threshold, 0))


@rival("hardie2000", estimate_registered_pattern)
def hardie2000(frames: Array, valid: Array, motion: Array | None) -> tuple[Array, Array]:
    """Fit each pixel's gain and bias to the registered average of the frames, by least squares.

    The scene is averaged along the trajectories of the motion; a line `y = gain z + bias` is fitted to the samples of
    each pixel. There is no prior: three frames leave one degree of freedom. The registration is deepir's.

    Source: R. C. Hardie, M. M. Hayat, E. Armstrong, B. Yasuda: Scene-based nonuniformity correction with video
    sequences and registration, Applied Optics 39 (2000).
    """
    if motion is None:
        seen = frames.mean(0, keepdims=True).repeat(len(frames), 0)
    else:
        seen = trajectory_means(frames, valid, motion)
    return fit_lines(seen, fill_invalid(frames, valid))


def trajectory_means(frames: Array, valid: Array, motion: Array) -> Array:
    """The scene at each sample (N, h, w): the mean of all frames along the trajectory of the motion through it."""
    points = np.stack([sampling_points(each, frames.shape[1:]) for each in motion])
    outside = np.abs(points).max(axis=(0, 2, 3)) - (np.array(frames.shape[1:]) - 1) / 2
    margin = [(0, 0), *((rim, rim) for rim in np.ceil(outside + 1e-6).astype(int))]
    mean = registered_mean(np.pad(frames, margin), np.pad(valid, margin), motion).numpy()
    return np.stack(
        [ndimage.map_coordinates(mean, to_indices(each, mean.shape), order=3, mode="mirror") for each in points]
    )


def fit_lines(scene: Array, frames: Array) -> tuple[Array, Array]:
    """Gain and bias (h, w) of `frames = gain * scene + bias`, (N, h, w); gain one where the scene is constant."""
    x, y = scene.astype(np.float64), frames.astype(np.float64)
    x_mean, y_mean = x.mean(0), y.mean(0)
    variance = ((x - x_mean) ** 2).sum(0)
    covariance = ((x - x_mean) * (y - y_mean)).sum(0)
    gain = np.divide(covariance, variance, out=np.ones_like(variance), where=variance > 0)
    return gain, y_mean - gain * x_mean
