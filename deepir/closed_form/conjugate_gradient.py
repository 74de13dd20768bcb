"""Conjugate gradients (Hestenes and Stiefel 1952), preconditioned."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor


def conjugate_gradient(
    product: Callable[[Tensor], Tensor],
    rhs: Tensor,
    start: Tensor,
    *,
    near: Callable[[Tensor], Tensor],
    precise: float,
    steps: int,
) -> Tensor:
    """The solution x of `product(x) = rhs`, for a symmetric positive definite product of vectors.

    Args:
        product: The matrix times a vector.
        rhs: The right-hand side.
        start: Where to begin.
        near: About the inverse of the matrix times a vector; symmetric and positive definite too.
        precise: The residual that is small enough, in the right-hand side.
        steps: At most so many.
    """
    x, rest = start.clone(), rhs - product(start)
    way = near(rest)
    square, least = rest @ way, precise**2 * (rhs @ near(rhs))
    for _ in range(steps):
        if square <= least:
            break
        image = product(way)
        step = square / (way @ image)
        x += step * way
        rest -= step * image
        better = near(rest)
        before, square = square, rest @ better
        way = better + square / before * way
    return x
