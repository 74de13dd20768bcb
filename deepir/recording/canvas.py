"""Frames of one scene on a common canvas: cubic spline warps in both directions.

Coordinates are px from the centre of a frame or of the canvas, x first. The canvas is the reference frame's grid,
extended by what the other frames see beyond it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.kernels.bspline import warp
from deepir.kernels.compile import parallel_for

Array = np.ndarray[Any, Any]

BORDER = (
    3  # px at a frame's edge that are not spread onto the canvas: the spline there would need samples beyond
)
MIN_SEEN = 0.99  # of the spline's weight that lies on known canvas, so that a sample counts as predicted


class Canvas:
    """The warps between n frames (h, w) and their canvas (H, W).

    Args:
        motion: Homographies (n, 3, 3) from a point of each frame to the canvas.
        size: (h, w) of the frames, px.

    Attributes:
        shape: (H, W) of the canvas, px.
    """

    def __init__(self, motion: Array, size: tuple[int, int]) -> None:
        self.size = size
        y, x = (np.array(each) for each in _corners(size))
        at = np.stack([np.stack(project(each, y, x)) for each in motion])
        reach = np.ceil(np.abs(at).max((0, 2))).astype(int) + BORDER
        self.shape = int(2 * reach[0] + 1), int(2 * reach[1] + 1)
        self.move(motion)

    def move(self, motion: Array) -> None:
        """Replace the motion; the canvas keeps its size."""
        self.motion = motion
        self._to_canvas = np.ascontiguousarray(motion, np.float32)
        self._to_frames = np.ascontiguousarray(np.linalg.inv(motion), np.float32)

    def __len__(self) -> int:
        return len(self.motion)

    def predicted(self, scene: Array) -> Array:
        """What frames (n, h, w) see of a scene (H, W)."""
        return _warped(spline(scene)[None], self._to_canvas, self.size)

    def spread(self, frames: Array) -> Array:
        """Frames (n or 1, h, w) on the canvas, (n, H, W)."""
        return _warped(np.stack([spline(each) for each in frames]), self._to_frames, self.shape)

    def spread_weights(self, weights: Array) -> Array:
        """Weights of samples (n, h, w) on the canvas, (n, H, W); zero outside the frames."""
        inner = np.zeros_like(weights)
        inside = np.s_[:, BORDER:-BORDER, BORDER:-BORDER]
        inner[inside] = weights[inside]
        return _warped(inner, self._to_frames, self.shape)

    def mean(self, frames: Array, spread_weights: Array) -> Array:
        """Weighted mean (H, W) of frames (n or 1, h, w) on the canvas; zero where no frame counts."""
        return weighted_mean(self.spread(frames), spread_weights)

    def is_seen(self, spread_weights: Array) -> Array:
        """Samples (n, h, w) whose place on the canvas some frame shows, bool."""
        known = (spread_weights.sum(0) > 0).astype(np.float32)
        return np.asarray(_warped(known[None], self._to_canvas, self.size) > MIN_SEEN)


def weighted_mean(values: Array, weights: Array) -> Array:
    """Mean over the first axis; zero where all weights are zero."""
    total = weights.sum(0)
    return np.asarray((weights * values).sum(0) / np.maximum(total, np.finfo(np.float32).tiny))


def project(motion: Array, y: Array, x: Array) -> tuple[Array, Array]:
    """Where a homography (3, 3) takes points, rows and columns."""
    depth = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2]
    return (
        (motion[1, 0] * x + motion[1, 1] * y + motion[1, 2]) / depth,
        (motion[0, 0] * x + motion[0, 1] * y + motion[0, 2]) / depth,
    )


def centred(size: Sequence[int]) -> tuple[Array, Array]:
    """Rows and columns of a grid (h, w), px from its centre."""
    y, x = np.indices(tuple(size), float)
    return y - (size[0] - 1) / 2, x - (size[1] - 1) / 2


def spline(values: Array) -> Array:
    """Coefficients of the cubic spline through samples (h, w), float32."""
    return np.asarray(ndimage.spline_filter(values, 3, output=np.float32, mode="mirror"))


def _corners(size: tuple[int, int]) -> tuple[list[float], list[float]]:
    bottom, right = (size[0] - 1) / 2, (size[1] - 1) / 2
    return [-bottom, -bottom, bottom, bottom], [-right, right, -right, right]


def _warped(coefficients: Array, motion: Array, shape: tuple[int, int]) -> Array:
    out = np.empty((len(motion), 1, *shape), np.float32)
    scene = np.ascontiguousarray(coefficients[:, None], np.float32)
    parallel_for(warp, shape[0], scene, motion, out)
    return out[:, 0]
