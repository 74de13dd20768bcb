"""Small steps of a homography: the displacements of its eight parameters, and their least-squares equations.

The parameters are shifts along x and y, turn, scale, stretch, shear, and the two of perspective; px at a distance of
half the longer side from the centre, the unit of all places here. Their displacements are polynomials of the place, so
that sums over all samples are moments of the scene's slopes: two small matrix products for each frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def _polynomials() -> Array:
    """Displacements of the parameters, (8, 2, 3, 3): down and across, as coefficients of powers of y and of x."""
    down = ["", "1", "x", "y", "-y", "x", "xy", "yy"]
    across = ["1", "", "-y", "x", "x", "y", "xx", "xy"]
    found = np.zeros((8, 2, 3, 3))
    for k, each in enumerate(zip(down, across, strict=True)):
        for axis, term in enumerate(each):
            if term:
                found[k, axis, term.count("y"), term.count("x")] = -1 if "-" in term else 1
    return found


POLYNOMIALS = _polynomials()


def centred(size: Sequence[int]) -> tuple[Array, Array]:
    """Rows and columns of a grid (h, w), px from its centre."""
    y, x = np.indices(tuple(size), float)
    return y - (size[0] - 1) / 2, x - (size[1] - 1) / 2


def homography_moments(down: Array, across: Array) -> Array:
    """Sums (n, 8), over the displacements by each parameter, of a quantity (n, h, w), down and across."""
    moments = np.stack([_moments(each, 3) for each in (down, across)])
    return np.einsum("dnij,kdij->nk", moments, POLYNOMIALS)


def homography_normal(down: Array, across: Array, weights: Array) -> Array:
    """Gauss-Newton's matrices (n, 8, 8), of a scene's slopes and the samples' weights, (n, h, w) each."""
    cross = _moments(weights * down * across, 5)
    moments = np.stack([_moments(weights * down**2, 5), cross, cross, _moments(weights * across**2, 5)])
    powers = np.add.outer(np.arange(3), np.arange(3))
    products = moments.reshape(2, 2, -1, 5, 5)[..., powers[:, :, None, None], powers]
    return np.asarray(np.einsum("kdij,lepq,denipjq->nkl", POLYNOMIALS, POLYNOMIALS, products, optimize=True))


def _moments(values: Array, orders: int) -> Array:
    """Sums (n, orders, orders) of values (n, h, w) over powers of row and of column, in units of half a side."""
    half = max(values.shape[1:]) / 2
    rows, columns = (
        np.power.outer((np.arange(side) - (side - 1) / 2) / half, np.arange(orders)).astype(values.dtype)
        for side in values.shape[1:]
    )
    return (rows.T @ (values @ columns)).astype(float)


def as_matrix(step: Array, half: float) -> Array:
    """The homography (3, 3) of a step of the parameters, px, in a frame of half a side, px."""
    dx, dy, turn, scale, stretch, shear, over_x, over_y = step / half
    return np.array(
        [
            [1 + scale + stretch, shear - turn, dx * half],
            [shear + turn, 1 + scale - stretch, dy * half],
            [-over_x / half, -over_y / half, 1],
        ]
    )
