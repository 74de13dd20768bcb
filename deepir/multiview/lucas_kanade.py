"""Dense optical flow from coarse to fine, by windows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.kernels.median_filter import median_filter
from deepir.kernels.optical_flow import box_sum, lucas_kanade, sample_bilinear

Array = np.ndarray[Any, Any]

RADIUS = 7  # px, half-width of a window
ITERATIONS = 4  # Gauss-Newton steps on each level
LEVELS = 3  # of the pyramid, each of half the resolution
MIN_SIDE = 12  # px, of the coarsest level
PYRAMID_SIGMA, GRADIENT_SIGMA = 1.0, 0.7  # px, of Gaussians before halving and before differences
#: Share of the median structure tensor's trace that is added to its diagonal: without texture, flow stays as it was.
DAMPING = 0.03
MEDIAN_SIDE = 5  # px, of the median filter of the flow on each level


class Pyramid:
    """A picture (h, w) at several resolutions, with gradients and structure tensors.

    Args:
        picture: (h, w).
        transform: what is registered of the picture at each resolution, same shape: its texture.
    """

    def __init__(self, picture: Array, transform: Callable[[Array], Array]) -> None:
        level = np.ascontiguousarray(picture, np.float64)
        self.levels: list[tuple[Array, Array, Array, float]] = []
        for _ in range(LEVELS):
            shown = transform(level)
            gradient = np.stack(np.gradient(ndimage.gaussian_filter(shown, GRADIENT_SIGMA)))
            self.levels.append((shown, gradient, *_structure_tensor(gradient)))
            if min(level.shape) < 2 * MIN_SIDE:
                break
            level = ndimage.gaussian_filter(level, PYRAMID_SIGMA)[::2, ::2].copy()

    @property
    def picture(self) -> Array:
        """What is registered at the finest level, (h, w)."""
        return self.levels[0][0]


def optical_flow(first: Pyramid, second: Pyramid) -> Array:
    """Displacement (2, h, w), px down and across, at which `second` shows what `first` shows at each pixel."""
    flow: Array | None = None
    for (here, gradient, tensor, damping), (there, *_) in zip(
        reversed(first.levels), reversed(second.levels), strict=True
    ):
        flow = np.zeros((2, *here.shape)) if flow is None else _enlarged(flow, here.shape)
        lucas_kanade(here, there, gradient, tensor, damping, RADIUS, ITERATIONS, flow)
        flow = np.stack([median_filter(each, MEDIAN_SIDE) for each in flow])
    assert flow is not None
    return flow


def sampled(values: Array, y: Array, x: Array) -> Array:
    """Bilinear interpolation of values (h, w) at points `y`, `x`; the nearest pixel's value beyond the border."""
    rows, columns = (np.atleast_2d(np.asarray(each, np.float64)) for each in (y, x))
    found = np.empty(rows.shape)
    sample_bilinear(np.asarray(values, np.float64), rows, columns, found)
    return found.reshape(np.shape(y))


def _structure_tensor(gradient: Array) -> tuple[Array, float]:
    """Structure tensor (yy, xy, xx), (3, h, w), summed over windows, and what is added to its diagonal."""
    down, across = gradient
    tensor, rows = np.empty((3, *down.shape)), np.empty(down.shape)
    for product, sums in zip((down * down, down * across, across * across), tensor, strict=True):
        box_sum(product, RADIUS, sums, rows)
    damping = DAMPING * float(np.median(tensor[0] + tensor[2])) + np.finfo(float).tiny
    tensor[0] += damping
    tensor[2] += damping
    return tensor, damping


def _enlarged(flow: Array, shape: tuple[int, ...]) -> Array:
    """A flow at twice the resolution: pixel (i, j) of the coarse grid is (2 i, 2 j) of the fine one."""
    y, x = np.meshgrid(*(np.arange(side) / 2 for side in shape), indexing="ij")
    return np.stack([2 * sampled(each, y, x) for each in flow])
