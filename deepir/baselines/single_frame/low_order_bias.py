"""A smooth bias, as heated optics add it: a polynomial chosen by the sparsity of the gradients."""

from __future__ import annotations

import dataclasses
from typing import Annotated

import numpy as np
from numpy.polynomial import legendre
from pydantic import Field

from deepir.baselines.average import Array, average, fill_invalid
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result

MAX_IRLS_ITERATIONS = 50  # iterations of reweighted least squares
IRLS_TOLERANCE = 1e-4  # change of the coefficients, relative to the largest, at which the iterations stop
NORM_SMOOTHING = 0.1  # smoothing of the norm at zero, in medians of the absolute residual gradients
MIN_BLOCKS = 8  # blocks along the shorter side of a frame


@register("method", "low_order_bias")
def low_order_bias(
    burst: Burst,
    config: Config,
    *,
    degree: Annotated[int, Field(ge=1, le=6)] = 2,
    exponent: Annotated[float, Field(gt=0, le=2)] = 1.0,
    block: Annotated[int, Field(ge=1)] = 8,
) -> Result:
    """Subtract the mean of the polynomials that minimise each frame's absolute gradients; then as `average`.

    A frame is the scene and a bivariate polynomial, and the scene's gradients have the least L1 norm. Simplified: noise
    stays in the scene, so scene and bias do not alternate. The coefficients are found by iteratively reweighted least
    squares on means of blocks. The gain stays one. A slope that all scenes share is taken for bias.

    Args:
        burst: The burst to correct.
        config: Its configuration.
        degree: Total degree of the polynomial.
        exponent: Exponent of the gradients' norm.
        block: Side of a block, px.

    Source: L. Liu, L. Yan, H. Zhao, X. Dai, T. Zhang: Correction of aeroheating-induced intensity nonuniformity in
    infrared images, Infrared Physics & Technology (2016); Y. Zheng, M. Grossman, S. Awate, J. Gee: Automatic correction
    of intensity nonuniformity from sparseness of gradient distribution in medical images, MICCAI (2009).
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    offset = np.mean([estimate_bias(frame, degree, exponent, block) for frame in frames], axis=0)
    offset -= offset[~burst.bad_pixels].mean()
    frames = (burst.frames - offset).astype(np.float32)
    result: Result = average(dataclasses.replace(burst, frames=frames), config)
    result.offset = offset.astype(np.float32)
    return result


def estimate_bias(frame: Array, degree: int = 2, exponent: float = 1.0, block: int = 8) -> Array:
    """The polynomial without which the gradients of a frame are sparsest.

    Gradients are differences of block means: between pixels, noise and rounding hide slow gradients.

    Args:
        frame: (h, w).
        degree: Total degree of the polynomial.
        exponent: Exponent of the gradients' norm.
        block: Side of a block, px.

    Returns:
        (h, w), mean zero.
    """
    terms = legendre_products(frame.shape, degree)
    side = max(1, min(block, min(frame.shape) // MIN_BLOCKS))
    target, *slopes = gradients(block_means(np.concatenate([frame[None].astype(np.float64), terms]), side))
    return np.asarray(np.tensordot(reweighted_least_squares(target, np.stack(slopes), exponent), terms, 1))


def reweighted_least_squares(target: Array, slopes: Array, exponent: float) -> Array:
    """Minimise `sum |target - coefficients slopes|^exponent` by iteratively reweighted least squares.

    Args:
        target: (M,).
        slopes: (K, M).
        exponent: In (0, 2].

    Returns:
        The coefficients (K,).
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


def block_means(pictures: Array, side: int) -> Array:
    """Means (N, h // side, w // side) over the whole blocks of pictures (N, h, w)."""
    count, height, width = pictures.shape[0], *(length // side for length in pictures.shape[1:])
    kept = pictures[:, : height * side, : width * side]
    return np.asarray(kept.reshape(count, height, side, width, side).mean((2, 4)))


def gradients(pictures: Array) -> Array:
    """Differences (N, M) of neighbours in pictures (N, h, w), along y and along x."""
    return np.concatenate([np.diff(pictures, axis=axis).reshape(len(pictures), -1) for axis in (1, 2)], 1)
