"""A sensor's pattern in the gradients of frames: the offset that frames share, and how much of one a frame has.

The pattern adds the same gradient to all frames at an edge between two pixels; the scenes add gradients of a heavy
tail, most of them next to nothing. The shared gradients are integrated by weighted least squares.

The error of an estimate comes from the scenes of its frames, and is in no others. So the slope of the gradients of
other frames over those of the estimate is the share of it that is the sensor's: one for a good estimate, zero for one
that is all scene.

Source: Weiss, "Deriving intrinsic images from image sequences", ICCV 2001, with Cauchy's likelihood for the median.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import dctn, idctn

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.closed_form.conjugate_gradient import conjugate_gradient
from deepir.kernels.compile import parallel_for
from deepir.kernels.gradients import shared_gradients

ITERATIONS = 6  # of reweighting at an edge
PCG_STEPS, PCG_TOLERANCE = 15, 1e-4  # of the integration: at most, and residual relative to the start
FRAMES_OF_SCALE = 15  # frames whose median gradients are taken off before the scale of each is measured
GRADIENT_STRIDE = 7  # of the gradients that give a frame's scale
MIN_VARIANCE = 1e-6  # of a frame's gradients, relative to the largest of all frames
REWEIGHTINGS = 8  # by Cauchy's likelihood: the scene's gradients have heavy tails
MAX_GRADIENTS = 10_000  # of a frame along each axis that are looked at
#: Share of the maps' pattern in a frame from which they fit, by one weighted fit, which underestimates patterns as weak
#: as the scene's gradients. In four simulated recordings it was 0.50 to 0.84 where the correction helped, and 0.11 to
#: 0.43 where not.
MIN_SHARE_TO_FIT = 0.45
SIGNIFICANCE = 2.0  # standard errors by which a share has to be too small
CORRELATED_GRADIENTS = 4.0  # gradients of neighbouring pixels that are correlated
RIDGE = 1e-6  # weak prior on a slope: without it, a part that is zero everywhere makes the system singular


def gradient_consensus(frames: Array, usable: Array) -> Array:
    """The offset (h, w), mean zero, float32, whose gradients are those that frames share.

    Args:
        frames: (N, h, w), of different scenes, or of one that moves.
        usable: (N, h, w) bool, which samples count; the others may be NaN.
    """
    level = np.float32(np.nanmedian(frames[:, ::4, ::4]))
    frames = np.ascontiguousarray(np.where(usable, frames, level), np.float32)
    good = np.ascontiguousarray(usable, bool).view(np.uint8)
    variances = _gradient_variances(frames)
    gradients, weights = [], []
    for down, right in ((1, 0), (0, 1)):
        shape = frames.shape[1] - down, frames.shape[2] - right
        gradient, weight = np.zeros(shape), np.zeros(shape)
        parallel_for(shared_gradients, shape[0], frames, good, variances, down, right, ITERATIONS, gradient, weight)
        gradients.append(gradient)
        weights.append(weight)
    offset = _integrated(gradients, weights)
    return np.asarray(offset - offset.mean(), np.float32)


def _gradient_variances(frames: Array) -> Array:
    """Squared scale of the gradients of each frame, less the median over frames: (N,), float32."""
    gradients = sampled_gradients(frames, GRADIENT_STRIDE, GRADIENT_STRIDE)
    common = np.median(gradients[:: max(1, len(frames) // FRAMES_OF_SCALE)], axis=0)
    variances = np.median(np.abs(gradients - common), axis=1) ** 2
    return np.maximum(variances, max(MIN_VARIANCE * variances.max(), np.finfo(np.float32).tiny)).astype(np.float32)


def sampled_gradients(frames: Array, stride_down: int, stride_across: int) -> Array:
    """Every so many of the differences down, then across, of neighbouring pixels: (N, samples)."""
    flat, width = frames.reshape(len(frames), -1), frames.shape[2]
    down = np.arange(0, flat.shape[1] - width, stride_down)
    across = np.arange(0, flat.shape[1] // width * (width - 1), stride_across)
    across += across // (width - 1)  # the last pixel of a row has none after it
    return np.concatenate([flat[:, down + width] - flat[:, down], flat[:, across + 1] - flat[:, across]], 1)


def _integrated(gradients: list[Array], weights: list[Array]) -> Array:
    """The map whose differences down and across are nearest to `gradients`; free edges."""
    height, width = gradients[0].shape[0] + 1, gradients[0].shape[1]
    mean = np.concatenate([weight.ravel() for weight in weights]).mean()

    def combined(edges: Sequence[Array]) -> Array:
        return np.ravel(sum(difference_adjoint(weights[axis] * edges[axis], axis) for axis in (0, 1)))

    score = combined(gradients)
    solution = conjugate_gradient(
        lambda offset: combined([np.diff(offset.reshape(height, width), axis=axis) for axis in (0, 1)]),
        score,
        np.zeros_like(score),
        precondition=lambda rest: np.ravel(_solved(rest.reshape(height, width))) / mean,
        tolerance=PCG_TOLERANCE,
        max_iterations=PCG_STEPS,
    )
    return np.asarray(solution).reshape(height, width)


def poisson(gradients: Sequence[Array]) -> Array:
    """The map (h, w), mean zero, whose differences down and across are nearest to `gradients`; free edges."""
    return _solved(difference_adjoint(gradients[0], 0) + difference_adjoint(gradients[1], 1))


def _solved(score: Array) -> Array:
    """The solution (h, w), mean zero, of Poisson's equation with free edges, by the cosine transform."""
    y, x = (2 - 2 * np.cos(np.pi * np.arange(side) / side) for side in score.shape)
    curvature = y[:, None] + x
    curvature[0, 0] = np.inf  # the level stays zero
    return np.asarray(idctn(dctn(score, norm="ortho", workers=-1) / curvature, norm="ortho", workers=-1))


def difference_adjoint(edges: Array, axis: int) -> Array:
    """The adjoint of `np.diff` along an axis."""
    return np.asarray(-np.diff(edges, axis=axis, prepend=0, append=0))


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
    (slope,), (error,) = shares(before[None], removed[None], ~bad & np.isfinite(removed), reweightings=reweightings)
    return bool(slope + SIGNIFICANCE * error > share)


def shares(frames: Array, parts: Array, known: Array, *, reweightings: int = REWEIGHTINGS) -> tuple[Array, Array]:
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
