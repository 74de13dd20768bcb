"""Dense displacements between frames of one sensor, from their texture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from deepir.arrays import Array
from deepir.kernels.compile import parallel_map
from deepir.kernels.median_filter import median_filter
from deepir.kernels.optical_flow import box_sum, lucas_kanade, sample_bilinear

RADIUS = 7  # px, half-width of a window
ITERATIONS = 4  # Gauss-Newton steps on each level
LEVELS = 3  # of the pyramid, each of half the resolution
MIN_SIDE = 12  # px, of the coarsest level
PYRAMID_SIGMA, GRADIENT_SIGMA = 1.0, 0.7  # px, of Gaussians before halving and before differences
#: Share of the median structure tensor's trace that is added to its diagonal: without texture, flow stays as it was.
DAMPING = 0.03
MEDIAN_SIDE = 5  # px, of the median filter of the flow on each level
SHORT_SIDE = 120  # px; frames are averaged to this shorter side, at least
TEXTURE_SIGMA = 8.0  # px of each resolution; Gaussian that separates texture from what is broader
CONTRAST_SIGMA = 16.0  # px of each resolution; Gaussian over which the contrast of the texture is normalised
CONTRAST_FLOOR = 0.3  # of the frame's median contrast, added to the local one: noise does not become texture
MAX_LOOP_ERROR = 1.0  # px; distance by which forward and backward displacement may miss the start
MIN_CORRELATION = 0.7  # normalised local correlation of texture from which a displacement is trusted
CORRELATION_SIGMA = 5.0  # px; Gaussian window of this correlation
MIN_DISPLACEMENT = 0.5  # px of the frames passed in; smaller displacements are no motion
BORDER = 2  # px from the border within which no displacement is trusted


Pyramid = list[tuple[Array, Array, Array, float]]  # of each resolution texture, gradient, structure tensor, damping


def texture_pyramid(frame: Array) -> Pyramid:
    """The texture of a frame (h, w) at several resolutions, the finest first."""
    level, levels = np.ascontiguousarray(frame, np.float64), []
    for _ in range(LEVELS):
        shown = texture(level)
        gradient = np.stack(np.gradient(ndimage.gaussian_filter(shown, GRADIENT_SIGMA)))
        levels.append((shown, gradient, *_structure_tensor(gradient)))
        if min(level.shape) < 2 * MIN_SIDE:
            break
        level = ndimage.gaussian_filter(level, PYRAMID_SIGMA)[::2, ::2].copy()
    return levels


def optical_flow(first: Pyramid, second: Pyramid) -> Array:
    """Displacement (2, h, w), px down and across, at which `second` shows what `first` shows at each pixel."""
    flow = np.zeros((2, *first[-1][0].shape))
    for (here, gradient, tensor, damping), (there, *_) in zip(first[::-1], second[::-1], strict=True):
        if flow.shape[1:] != here.shape:
            y, x = np.meshgrid(*(np.arange(side) / 2 for side in here.shape), indexing="ij")
            flow = np.stack([2 * sampled(each, y, x) for each in flow])
        lucas_kanade(here, there, gradient, tensor, damping, RADIUS, ITERATIONS, flow)
        flow = np.stack([median_filter(each, MEDIAN_SIDE) for each in flow])
    return flow


def sampled(values: Array, y: Array, x: Array) -> Array:
    """Bilinear interpolation of values (h, w) at points `y`, `x`; the nearest pixel's value beyond the border."""
    rows, columns = (np.atleast_2d(np.asarray(each, np.float64)) for each in (y, x))
    found = np.empty(rows.shape)
    sample_bilinear(np.asarray(values, np.float64), rows, columns, found)
    return found.reshape(np.shape(y))


def enlarged(means: Array, size: Sequence[int], factor: int) -> Array:
    """A map of means over blocks of `factor` px at each px of `size`, bilinear about the blocks' centres."""
    y, x = ((np.arange(side) + 0.5) / factor - 0.5 for side in size)
    return sampled(means, *np.meshgrid(y, x, indexing="ij"))


def coarsening(size: Sequence[int]) -> int:
    """Side of the blocks, px, over which frames of a size are averaged before displacements are sought."""
    return max(1, min(size) // SHORT_SIDE)


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


@dataclass(frozen=True)
class Displacement:
    """Displacement field from frame `first` to frame `second`.

    Attributes:
        first, second: numbers of the frames.
        y, x: (h, w), row and column, px, at which the second frame shows what the first shows at each pixel.
        known: (h, w) bool, True where these are trusted.
    """

    first: int
    second: int
    y: Array
    x: Array
    known: Array

    @property
    def vectors(self) -> Array:
        """Displacement down and across, (2, h, w), px."""
        return np.stack([self.y, self.x]) - np.indices(self.y.shape)

    @property
    def share_moved(self) -> float:
        """Fraction of the frame whose displacement is trusted and at least `MIN_DISPLACEMENT` px."""
        moved = np.hypot(*self.vectors) >= MIN_DISPLACEMENT
        return float((moved & self.known).mean())


def displacements(frames: Array, pairs: Sequence[tuple[int, int]]) -> list[Displacement]:
    """Displacements between pairs of frames by the optical flow of their texture, forward and backward.

    Args:
        frames: (N, h, w) float64, finite, with little fixed pattern left.
        pairs: numbers of the first and the second frame.
    """
    wanted = sorted({k for pair in pairs for k in pair})
    textures = dict(zip(wanted, parallel_map(lambda k: texture_pyramid(frames[k]), wanted), strict=True))
    return parallel_map(lambda pair: _displacement(pair, textures), pairs)


def texture(frame: Array) -> Array:
    """High-pass of a frame (h, w), divided by its local contrast; standard deviation one."""
    detail = frame - ndimage.gaussian_filter(frame, TEXTURE_SIGMA)
    contrast = np.sqrt(ndimage.gaussian_filter(detail**2, CONTRAST_SIGMA))
    even = detail / (contrast + CONTRAST_FLOOR * np.median(contrast) + np.finfo(float).tiny)
    return np.asarray(even / max(even.std(), np.finfo(float).tiny))


def _displacement(pair: tuple[int, int], textures: dict[int, Pyramid]) -> Displacement:
    """A displacement, trusted where that back returns to the start and the local correlation is high."""
    first, second = (textures[k] for k in pair)
    ahead, back = optical_flow(first, second), optical_flow(second, first)
    here, there = first[0][0], second[0][0]
    height, width = here.shape
    rows, columns = np.mgrid[:height, :width].astype(float)
    y, x = rows + ahead[0], columns + ahead[1]
    inside = (y >= BORDER) & (y <= height - 1 - BORDER) & (x >= BORDER) & (x <= width - 1 - BORDER)
    loop_error = np.hypot(*(ahead[i] + sampled(back[i], y, x) for i in (0, 1)))
    matched = sampled(there, y, x)

    def local_mean(values: Array) -> Array:
        return np.asarray(ndimage.gaussian_filter(values, CORRELATION_SIGMA))

    energy = np.sqrt(local_mean(here**2) * local_mean(matched**2))
    is_correlated = local_mean(here * matched) > MIN_CORRELATION * np.maximum(energy, np.finfo(float).tiny)
    return Displacement(*pair, y, x, inside & (loop_error < MAX_LOOP_ERROR) & is_correlated)
