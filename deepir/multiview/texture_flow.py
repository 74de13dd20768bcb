"""Dense displacements between frames of one sensor, found from their texture.

Optical flow by brightness follows what is slow of a fixed pattern, and changes of level and contrast. So frames are
compared by their texture, and only displacements that hold both ways are kept.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from skimage.registration import optical_flow_ilk

Array = np.ndarray

SHORT_SIDE = 120  # px; frames are averaged to this shorter side, at least
TEXTURE_SIGMA = 8.0  # px; Gaussian that separates texture from what is broader
CONTRAST_SIGMA = 16.0  # px; Gaussian over which the contrast of the texture is normalised
CONTRAST_FLOOR = (
    0.3  # of the frame's median contrast, added to the local one: plain areas do not become texture
)
RADIUS = 7  # px; half-width of the Lucas-Kanade window
WARPS = 10  # warps of the Lucas-Kanade flow
MAX_LOOP_ERROR = 1.0  # px; distance by which forward and backward displacement may miss the start
MIN_CORRELATION = 0.7  # normalised local correlation of texture from which a displacement is trusted
CORRELATION_SIGMA = 5.0  # px; Gaussian window of this correlation
MIN_DISPLACEMENT = 0.5  # px of the frames passed in; smaller displacements are no motion
BORDER = 2  # px from the border within which no displacement is trusted


@dataclass(frozen=True)
class Displacement:
    """Where frame `second` shows what frame `first` does: rows `y`, columns `x`, px, (h, w); `known`: where it does."""

    first: int
    second: int
    y: Array
    x: Array
    known: Array

    @property
    def share_moved(self) -> float:
        """Share of the frame that is known to have moved, by `LEAST_MOVED` px and more."""
        rows, columns = np.mgrid[: self.y.shape[0], : self.y.shape[1]]
        moved = np.hypot(self.y - rows, self.x - columns) >= MIN_DISPLACEMENT
        return float((moved & self.known).mean())


def displacements(frames: Array, pairs: Iterable[tuple[int, int]]) -> Iterator[Displacement]:
    """Displacements between pairs of frames (N, h, w) float64 that hold little pattern, and nothing but finite values.

    Inverse Lucas-Kanade on texture (Le Besnerais and Champagnat 2005, as scikit-image has it), both ways.
    """
    textures: dict[int, Array] = {}
    for first, second in pairs:
        for k in (first, second):
            if k not in textures:
                textures[k] = texture(frames[k])
        yield _displacement(first, second, textures)


def texture(frame: Array) -> Array:
    """What is fine of a frame (h, w), of even contrast; zero mean square one."""
    detail = frame - ndimage.gaussian_filter(frame, TEXTURE_SIGMA)
    contrast = np.sqrt(ndimage.gaussian_filter(detail**2, CONTRAST_SIGMA))
    even = detail / (contrast + CONTRAST_FLOOR * np.median(contrast) + np.finfo(float).tiny)
    return np.asarray(even / max(even.std(), np.finfo(float).tiny))


def _displacement(first: int, second: int, textures: dict[int, Array]) -> Displacement:
    here, there = textures[first], textures[second]
    height, width = here.shape
    rows, columns = np.mgrid[:height, :width].astype(float)
    ahead = optical_flow_ilk(here, there, radius=RADIUS, num_warp=WARPS)
    back = optical_flow_ilk(there, here, radius=RADIUS, num_warp=WARPS)
    y, x = rows + ahead[0], columns + ahead[1]
    inside = (y >= BORDER) & (y <= height - 1 - BORDER) & (x >= BORDER) & (x <= width - 1 - BORDER)
    loop = np.hypot(*(ahead[i] + sampled(back[i], y, x) for i in (0, 1)))
    arrived = sampled(there, y, x)

    def near(values: Array) -> Array:
        return np.asarray(ndimage.gaussian_filter(values, CORRELATION_SIGMA))

    energy = np.sqrt(near(here**2) * near(arrived**2))
    alike = near(here * arrived) > MIN_CORRELATION * np.maximum(energy, np.finfo(float).tiny)
    return Displacement(first, second, y, x, inside & (loop < MAX_LOOP_ERROR) & alike)


def sampled(values: Array, y: Array, x: Array) -> Array:
    """A map (h, w) at points, bilinear; the nearest pixel's value beyond its border."""
    return np.asarray(ndimage.map_coordinates(values, [y, x], order=1, mode="nearest"))
