"""Flat field and dark field of many images, from a low-rank part and a sparse rest (BaSiC)."""

from __future__ import annotations

import numpy as np
from scipy.fft import dctn, idctn

from deepir.baselines.average import Array, correct_and_average, fill_invalid
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result

FRAMES = 64  # frames of a long recording that are used, evenly spread
REWEIGHTINGS = 3
ITERATIONS = 60  # of each reweighting, at most
TOLERANCE = 1e-4  # rest that the model leaves, relative to the frames, at which the iterations end
PENALTY_GROWTH = 1.5  # factor of the quadratic penalty from an iteration to the next
#: Weights of the sparse spectra: of the flat field over the mean frame's spectrum, of the dark field over the former.
FLAT_WEIGHT, DARK_WEIGHT = 1 / 800, 0.2
REWEIGHTING_FLOOR = 0.1  # smallest scaled residual that a weight is the inverse of


@register("method", "basic")
def basic(burst: Burst, config: Config) -> Result:
    """Flat field and dark field with sparse spectra under a sparse scene (BaSiC); then register and average.

    Source: T. Peng, K. Thorn, T. Schroeder, L. Wang, F. J. Theis, C. Marr, N. Navab: A BaSiC tool for background and
    shading correction of optical microscopy images, Nature Communications 8 (2017).
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return correct_and_average(burst, config, *flat_and_dark_field(frames))


def flat_and_dark_field(frames: Array) -> tuple[Array, Array]:
    """Flat field (mean one) and dark field (mean zero), (h, w): gain and offset of frames (N, h, w).

    The model is `y_k = b_k flat + dark + r_k`, with as small a sum of `|w r|` and of the fields' cosine spectra as
    can be. The weights w are inverse residuals, found in turn with the rest. As in the authors' program the values of
    each pixel are sorted first, which makes the scenes alike.
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
