"""Offsets from the gradients of frames: their medians and means, and polynomials that leave them sparse."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from numpy.polynomial import legendre
from pydantic import Field

from deepir.baselines.rival import Array, estimate_mean_offset, estimate_offset, last_of, rival
from deepir.kernels.block_means import block_means
from deepir.multiview.pattern_gradients import difference_adjoint, poisson

STEP_LENGTH = 1.0  # largest change of a pixel by the first frame, in typical gradients
TV_SMOOTHING = 0.1  # smoothing of the total variation at zero, in typical gradients
TRIMMED_SHARE = 0.25  # share of the frames left out at either end of the sorted gradients
MAX_IRLS_ITERATIONS = 50  # iterations of reweighted least squares
IRLS_TOLERANCE = 1e-4  # change of the coefficients, relative to the largest, at which the iterations stop
NORM_SMOOTHING = 0.1  # smoothing of the norm at zero, in medians of the absolute residual gradients
MIN_BLOCKS = 8  # blocks along the shorter side of a frame


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
    """Offset (h, w), mean zero, after each frame of (N, h, w), with steps of length `1 / sqrt(k + 1)`."""
    offset = np.zeros(frames.shape[1:])
    typical = float(np.median(np.abs(np.diff(frames[0], axis=-1)))) or 1.0
    for k, frame in enumerate(frames):
        slope = np.zeros_like(offset)
        for axis in (-1, -2):
            gradient = np.diff(frame - offset, axis=axis)
            slope += difference_adjoint(gradient / np.hypot(gradient, TV_SMOOTHING * typical), axis)
        offset += STEP_LENGTH * typical / np.sqrt(k + 1) * slope / 4
        yield offset - offset.mean()


@rival("low_order_bias", estimate_mean_offset)
def low_order_bias(
    frame: Array,
    *,
    degree: Annotated[int, Field(ge=1, le=6)] = 2,
    exponent: Annotated[float, Field(gt=0, le=2)] = 1.0,
    block: Annotated[int, Field(ge=1)] = 8,
) -> Array:
    """Subtract the mean of the polynomials that minimise each frame's absolute gradients; then as `average`.

    A frame is the scene and a bivariate polynomial, and the scene's gradients have the least L1 norm. Simplified: noise
    stays in the scene, so scene and bias do not alternate. The coefficients are found by iteratively reweighted least
    squares on means of blocks: between pixels, noise and rounding hide slow gradients. The gain stays one. A slope that
    all scenes share is taken for bias.

    Args:
        frame: (h, w).
        degree: Total degree of the polynomial.
        exponent: Exponent of the gradients' norm.
        block: Side of a block, px.

    Returns:
        The polynomial of the frame, (h, w), mean zero.

    Source: L. Liu, L. Yan, H. Zhao, X. Dai, T. Zhang: Correction of aeroheating-induced intensity nonuniformity in
    infrared images, Infrared Physics & Technology (2016); Y. Zheng, M. Grossman, S. Awate, J. Gee: Automatic correction
    of intensity nonuniformity from sparseness of gradient distribution in medical images, MICCAI (2009).
    """
    terms = legendre_products(frame.shape, degree)
    side = max(1, min(block, min(frame.shape) // MIN_BLOCKS))
    pictures = np.concatenate([frame[None].astype(np.float64), terms])
    target, *slopes = gradients(block_means(pictures, np.ones(pictures.shape, bool), side))
    return np.asarray(np.tensordot(reweighted_least_squares(target, np.stack(slopes), exponent), terms, 1))


def reweighted_least_squares(target: Array, slopes: Array, exponent: float) -> Array:
    """Minimise `sum |target - coefficients slopes|^exponent` by iteratively reweighted least squares.

    Of a target (M,), slopes (K, M) and an exponent in (0, 2]; gives the coefficients (K,).
    """
    coefficients, weight = np.zeros(len(slopes)), np.ones_like(target)
    tiny = 1e-9 * float(np.abs(target).max()) or 1.0
    for _ in range(MAX_IRLS_ITERATIONS):
        before = coefficients
        weighted = slopes * weight
        coefficients = np.linalg.solve(weighted @ slopes.T, weighted @ target)
        if np.abs(coefficients - before).max() <= IRLS_TOLERANCE * np.abs(coefficients).max():
            break
        residual = np.abs(target - coefficients @ slopes)
        scale = NORM_SMOOTHING * float(np.median(residual)) + tiny
        weight = np.hypot(residual / scale, 1) ** (exponent - 2)
    return coefficients


def legendre_products(shape: tuple[int, ...], degree: int) -> Array:
    """Products (K, h, w) of Legendre polynomials of y and x of total degree 1 to `degree`, each of mean zero."""
    y, x = (legendre.legvander(np.linspace(-1, 1, side), degree) for side in shape)
    orders = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)][1:]
    terms = np.stack([np.outer(y[:, i], x[:, j]) for i, j in orders])
    return np.asarray(terms - terms.mean((1, 2), keepdims=True))


def gradients(pictures: Array) -> Array:
    """Differences (N, M) of neighbours in pictures (N, h, w), along y and along x."""
    return np.concatenate([np.diff(pictures, axis=axis).reshape(len(pictures), -1) for axis in (1, 2)], 1)
