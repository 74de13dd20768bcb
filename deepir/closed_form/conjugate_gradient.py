"""Conjugate gradients, of torch's or numpy's vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

if TYPE_CHECKING:
    from torch import Tensor

V = TypeVar("V", "Tensor", "np.ndarray[Any, Any]")


def conjugate_gradient(
    multiply: Callable[[V], V],
    rhs: V,
    start: V,
    *,
    precondition: Callable[[V], V],
    tolerance: float,
    max_iterations: int,
) -> V:
    """Solve `A x = b` for a symmetric positive definite matrix A.

    Args:
        multiply: `x -> A x`, on vectors (n,), of torch or numpy.
        rhs: b, (n,).
        start: First iterate, (n,).
        precondition: `r -> M r` with M close to the inverse of A; symmetric positive definite.
        tolerance: Norm of the residual, relative to that of b, at which to stop; in the metric of M.
        max_iterations: Most iterations.

    Returns:
        The last iterate, (n,); not finite if `rhs` is not.

    Source: Hestenes and Stiefel 1952, "Methods of conjugate gradients for solving linear systems".
    """
    residual = rhs - multiply(start)
    x = start + 0 * residual  # NaN and infinity stay visible
    preconditioned = precondition(residual)
    direction = preconditioned
    rho, goal = residual @ preconditioned, tolerance**2 * (rhs @ precondition(rhs))
    for _ in range(max_iterations):
        if not rho > goal:
            break
        conjugate = multiply(direction)
        alpha = rho / (direction @ conjugate)
        x += alpha * direction
        residual = residual - alpha * conjugate  # `precondition` may have returned it
        preconditioned = precondition(residual)
        previous_rho, rho = rho, residual @ preconditioned
        beta = rho / previous_rho
        direction = preconditioned + beta * direction
    return x
