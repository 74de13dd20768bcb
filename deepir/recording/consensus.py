"""The offset that frames of different scenes share, from their gradients.

The pattern adds the same gradient to all frames at an edge between two pixels; the scenes add gradients of a heavy
tail, most of them next to nothing. The shared gradients are integrated by weighted least squares.

Source: Weiss, "Deriving intrinsic images from image sequences", ICCV 2001, with Cauchy's likelihood for the median.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Tensor

from deepir.closed_form.normal_equations import conjugate_gradient
from deepir.kernels.compile import parallel_for
from deepir.kernels.gradients import shared_gradients

Array = np.ndarray[Any, Any]

ITERATIONS = 6  # of reweighting at an edge
PCG_STEPS, PCG_TOLERANCE = 15, 1e-4  # of the integration: at most, and residual relative to the start
FRAMES_OF_SCALE = 15  # frames whose median gradients are taken off before the scale of each is measured
GRADIENT_STRIDE = 7  # of the gradients that give a frame's scale
MIN_VARIANCE = 1e-6  # of a frame's gradients, relative to the largest of all frames


def gradient_consensus(frames: Array, usable: Array) -> Array:
    """The offset (h, w), mean zero, whose gradients are those that frames share.

    Args:
        frames: (N, h, w), of different scenes, or of one that moves.
        usable: (N, h, w) bool, which samples count.
    """
    frames = np.ascontiguousarray(frames, np.float32)
    good = np.ascontiguousarray(usable, np.uint8)
    variances = _gradient_variances(frames)
    gradients, weights = [], []
    for down, right in ((1, 0), (0, 1)):
        shape = frames.shape[1] - down, frames.shape[2] - right
        gradient, weight = np.zeros(shape), np.zeros(shape)
        parallel_for(
            shared_gradients, shape[0], frames, good, variances, down, right, ITERATIONS, gradient, weight
        )
        gradients.append(gradient)
        weights.append(weight)
    offset = _integrated(gradients, weights)
    return np.asarray(offset - offset.mean())


def _gradient_variances(frames: Array) -> Array:
    """Squared scale of the gradients of each frame, less the median over frames: (N,), float32."""
    gradients = sampled_gradients(frames, GRADIENT_STRIDE, GRADIENT_STRIDE)
    common = np.median(gradients[:: max(1, len(frames) // FRAMES_OF_SCALE)], axis=0)
    variances = np.median(np.abs(gradients - common), axis=1) ** 2
    return np.maximum(variances, max(MIN_VARIANCE * variances.max(), np.finfo(np.float32).tiny)).astype(
        np.float32
    )


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
    y, x = (2 - 2 * np.cos(np.pi * np.arange(side) / side) for side in (height, width))
    curvature = np.mean([weight.mean() for weight in weights]) * (y[:, None] + x)
    curvature[0, 0] = np.inf  # the level stays zero

    def flat(values: Any) -> Tensor:
        return torch.from_numpy(np.asarray(values).ravel())

    def normal(offset: Tensor) -> Tensor:
        steps = [np.diff(offset.numpy().reshape(height, width), axis=axis) for axis in (0, 1)]
        return flat(sum(_adjoint(weights[axis] * steps[axis], axis) for axis in (0, 1)))

    def precondition(rest: Tensor) -> Tensor:
        spectrum = dctn(rest.numpy().reshape(height, width), norm="ortho", workers=-1) / curvature
        return flat(idctn(spectrum, norm="ortho", workers=-1))

    score = flat(sum(_adjoint(weights[axis] * gradients[axis], axis) for axis in (0, 1)))
    solution = conjugate_gradient(
        normal,
        score,
        torch.zeros_like(score),
        precondition=precondition,
        tolerance=PCG_TOLERANCE,
        max_iterations=PCG_STEPS,
    )
    return solution.numpy().reshape(height, width)


def _adjoint(edges: Array, axis: int) -> Array:
    """The adjoint of differences along an axis."""
    return np.asarray(-np.diff(edges, axis=axis, prepend=0, append=0))
