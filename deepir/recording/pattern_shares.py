"""How much of an estimated pattern is in frames that it was not estimated from.

The error of an estimate comes from the scenes of its frames, and is in no others. So the slope of the gradients of
other frames over those of the estimate is the share of it that is the sensor's: one for a good estimate, zero for one
that is all scene.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.recording.consensus import sampled_gradients

Array = np.ndarray[Any, Any]

REWEIGHTINGS = 8  # by Cauchy's likelihood: the scene's gradients have heavy tails
MAX_GRADIENTS = 10_000  # of a frame along each axis that are looked at
#: Share of the maps' pattern in a frame from which they fit, by one weighted fit, which underestimates patterns as weak
#: as the scene's gradients. In four simulated recordings it was 0.50 to 0.84 where the correction helped, and 0.11 to
#: 0.43 where not.
MIN_SHARE_TO_FIT = 0.45
SIGNIFICANCE = 2.0  # standard errors by which a share has to be too small
CORRELATED_GRADIENTS = 4.0  # gradients of neighbouring pixels that are correlated
RIDGE = 1e-6  # weak prior on a slope: without it, a part that is zero everywhere makes the system singular


def contains_pattern(frame: Array, corrected: Array, bad: Array) -> bool:
    """Whether a frame (h, w) contains the pattern that its correction removes, as far as its gradients show.

    Args:
        frame: before the correction.
        corrected: after it.
        bad: (h, w) bool, pixels that do not count.
    """
    return _share_may_exceed(MIN_SHARE_TO_FIT, frame, corrected, bad, reweightings=1)


def removes_more(corrected: Array, other: Array, bad: Array) -> bool:
    """Whether a second correction of a frame removes more pattern than a first; arguments as in `contains_pattern`."""
    return _share_may_exceed(0.5, corrected, other, bad, reweightings=REWEIGHTINGS)


def _share_may_exceed(share: float, before: Array, after: Array, bad: Array, *, reweightings: int) -> bool:
    """Whether the share of the difference in the first frame exceeds `share`, within `SIGNIFICANCE` standard errors."""
    removed = before - after
    known = ~bad & np.isfinite(removed)
    (slope,), (error,) = shares(before[None], removed[None], known, reweightings=reweightings)
    return bool(slope + SIGNIFICANCE * error > share)


def shares(
    frames: Array,
    parts: Array,
    known: Array,
    *,
    reweightings: int = REWEIGHTINGS,
) -> tuple[Array, Array]:
    """Slopes of the gradients of frames over those of parts, by robust least squares.

    Args:
        frames: (N, h, w); NaN where a sample does not count.
        parts: (K, h, w), in the same units.
        known: (h, w) bool, pixels that count.
        reweightings: number of weighted fits: the first weights are by the frames' gradients, the others by residuals.

    Returns:
        Slopes (K,) and their standard errors (K,).
    """
    stride = max(1, known.size // MAX_GRADIENTS)
    design = sampled_gradients(np.where(known, parts, np.nan), stride, stride)
    return slopes(sampled_gradients(frames, stride, stride), design, reweightings=reweightings)


def slopes(steps: Array, design: Array, *, reweightings: int = REWEIGHTINGS) -> tuple[Array, Array]:
    """Slopes of samples over those of parts, by robust least squares.

    Args:
        steps: (N, samples); NaN where a sample does not count.
        design: (K, samples), in the same units; NaN as well.
        reweightings: see `shares`.

    Returns:
        Slopes (K,) and their standard errors (K,).
    """
    good = np.isfinite(design).all(0)
    design, steps = design[:, good], steps[:, good]
    found: Array = np.zeros(len(design))
    tiny = float(np.finfo(np.float32).tiny)
    for _ in range(reweightings):
        normal, score = RIDGE * np.eye(len(design)), np.zeros(len(design))
        scatter = normal.copy()
        for frame in steps:
            seen = np.isfinite(frame)
            step, each = frame[seen], design[:, seen]
            rest = step - found @ each
            scale = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), tiny) if rest.size else 1.0
            weighted = each / (scale**2 + rest**2)
            normal += _products(weighted, each)
            score += _products(weighted, step[None])[:, 0]
            scatter += CORRELATED_GRADIENTS * _products(weighted * rest, weighted * rest)
        found = np.linalg.solve(normal, score)
    covariance = np.linalg.solve(normal, np.linalg.solve(normal, scatter).T)
    return found, np.sqrt(np.diag(covariance))


def _products(one: Array, other: Array) -> Array:
    """Sums of products of (K, S) and (L, S): (K, L). Not by BLAS: its threads wait for each other on busy cores."""
    return np.asarray(np.einsum("ks,ls->kl", one, other))
