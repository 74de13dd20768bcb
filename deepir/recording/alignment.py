"""Motion of frames of one scene, once the fixed pattern is taken off: phase of shifts first, then Gauss-Newton steps.

Under a fixed pattern every registration finds no motion. A first estimate of the pattern, from the gradients that all
frames share, removes that bias, whatever the pattern's strength.

Frames are compared on a canvas: the reference frame's grid, extended by what the other frames see beyond it. Cubic
splines warp in both directions. Coordinates are px from the centre of a frame or of the canvas, x first.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import fft, ndimage

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.kernels.bspline import warp
from deepir.kernels.compile import parallel_for

Array = np.ndarray[Any, Any]

BORDER = 3  # px at a frame's edge that are not spread onto the canvas: the spline there would need samples beyond
MIN_SEEN = 0.99  # of the spline's weight that lies on known canvas, so that a sample counts as predicted
SHIFT_SIGMA = 6.0  # px; Gaussian whose mean is taken off before frames are correlated
REFINE_SIGMA = 8.0  # px; the same before motion is refined: what is slower is left to the sensor's estimate
LIMIT = 0.9  # quantile of the strength of a frame's detail, at which it is limited
MIN_OVERLAP = 0.3  # of the frames' windows, of a shift that is considered
PADDING = 1.8  # sides of the correlated frames with zeros beyond, relative to the frames
MAX_STEPS, LAST_STEP = 6, 2e-2  # Gauss-Newton steps, at most; px, of the last one
TURN = 3  # parameters of the motion of a camera that turns
OUTLIER_SIGMAS = 2.0  # of residuals, scale of Cauchy's weights


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
        reach = np.ceil(np.abs(corners(motion, size)).max((0, 2))).astype(int) + BORDER
        self.shape = int(2 * reach[0] + 1), int(2 * reach[1] + 1)
        self.move(motion)

    def move(self, motion: Array) -> None:
        """Replace the motion; the canvas keeps its size."""
        self.motion = motion
        self._to_canvas = np.ascontiguousarray(motion, np.float32)
        self._to_frames = np.ascontiguousarray(np.linalg.inv(motion), np.float32)

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


def corners(motion: Array, size: Sequence[int]) -> Array:
    """Rows and columns (n, 2, 4) to which motion (n, 3, 3) takes the corners of frames (h, w)."""
    y, x = (each[:: size[0] - 1, :: size[1] - 1].ravel() for each in centred(size))
    return np.stack([np.stack(project(each, y, x)) for each in motion])


def _warped(coefficients: Array, motion: Array, shape: tuple[int, int]) -> Array:
    out = np.empty((len(motion), 1, *shape), np.float32)
    scene = np.ascontiguousarray(coefficients[:, None], np.float32)
    parallel_for(warp, shape[0], scene, motion, out)
    return out[:, 0]


@dataclass(frozen=True)
class Spectrum:
    """Transforms of a windowed frame, of its square and of the window, for masked correlation."""

    frame: Array
    square: Array
    window: Array
    padded: tuple[int, int]

    @classmethod
    def of(cls, frame: Array) -> Spectrum:
        """Of a frame (h, w), less its low-order part; limited, as a hot person who walks would outweigh the scene."""
        height, width = frame.shape
        padded = fft.next_fast_len(int(PADDING * height)), fft.next_fast_len(int(PADDING * width))
        window = np.sqrt(np.outer(*(np.hanning(side + 2)[1:-1] for side in frame.shape))).astype(np.float32)
        detail = frame - ndimage.gaussian_filter(frame, SHIFT_SIGMA)
        detail = detail.clip(*np.quantile(np.abs(detail), LIMIT) * np.array([-1, 1]))
        shown, square, whole = (fft.rfft2(part, padded) for part in (detail * window, detail**2 * window, window))
        return cls(shown, square, whole, padded)


def find_shift(reference: Spectrum, frame: Spectrum) -> tuple[Array, float]:
    """The shift (x, y), px, from a frame to the reference, and the correlation there, at most one.

    Source: Padfield, "Masked object registration in the Fourier domain", IEEE Trans. Image Process. 21, 2012.
    """

    def correlation(one: Array, other: Array) -> Array:
        return np.asarray(fft.irfft2(np.conj(other) * one, reference.padded))

    overlap = correlation(reference.window, frame.window)
    energy = np.sqrt(
        np.maximum(correlation(reference.square, frame.window), 0)
        * np.maximum(correlation(reference.window, frame.square), 0)
    )
    is_wide = (overlap > MIN_OVERLAP * overlap.max()) & (energy > 1e-3 * energy.max())
    score = np.where(is_wide, correlation(reference.frame, frame.frame) / np.where(is_wide, energy, 1), -1.0)
    peak = np.unravel_index(int(score.argmax()), score.shape)
    shift = []
    for axis, (at, side) in enumerate(zip(peak, score.shape, strict=True)):
        before, here, after = (
            score[tuple(np.where(np.arange(2) == axis, (at + step) % side, peak))] for step in (-1, 0, 1)
        )
        curvature = before - 2 * here + after
        between = 0.5 * (before - after) / curvature if curvature < 0 and min(before, after) > -1 else 0.0
        shift.append((at if at < side / 2 else at - side) + between)
    return np.array(shift[::-1]), float(min(score[peak], 1.0))


@dataclass(frozen=True)
class Links:
    """Frames that were each compared with the reference or with a neighbour towards it, whichever chain is better.

    Attributes:
        reference: its number.
        parents: number of the frame that each was compared with, (n,).
        shifts: from each to its parent, x and y, px, (n, 2).
        likeness: the lowest correlation along each frame's chain, (n,).
    """

    reference: int
    parents: Array
    shifts: Array
    likeness: Array

    @classmethod
    def of(cls, spectra: Sequence[Spectrum], reference: int) -> Links:
        """Links between frames in their order."""
        count = len(spectra)
        parents, shifts, likeness = np.full(count, reference), np.zeros((count, 2)), np.ones(count)
        for order, step in ((range(reference + 1, count), -1), (range(reference - 1, -1, -1), 1)):
            for k in order:
                found = []
                for other in {reference, k + step}:
                    shift, alike = find_shift(spectra[other], spectra[k])
                    found.append((min(alike, likeness[other]), other, *shift))
                likeness[k], parents[k], *shifts[k] = max(found)
        return cls(reference, parents, shifts, likeness)

    def motion(self, curvature: float, half: float) -> Array:
        """Motion (n, 3, 3) to the reference, of a camera that turns; `half` is half the longer side of a frame, px."""
        found = np.tile(np.eye(3), (len(self.parents), 1, 1))
        near_first = np.argsort(np.abs(np.arange(len(found)) - self.reference))
        for k in near_first[1:]:
            found[k] = found[self.parents[k]] @ turned(self.shifts[k], curvature, half)
        return found


def turned(shift: Array, curvature: float, half: float) -> Array:
    """The homography (3, 3) of a camera that turns so that the middle of what both frames show moves by `shift`, px.

    Args:
        shift: (x, y), px, from half of it on the one side of the frame's centre to half of it on the other.
        curvature: squared tangent of half the field of view along the longer side; 0: of a far camera, a shift.
        half: half the longer side, px.
    """
    if curvature == 0:
        return np.array([[1.0, 0, shift[0]], [0, 1, shift[1]], [0, 0, 1]])
    focal = half / curvature**0.5
    tangent = shift / (2 * focal)  # of half the angle
    across = np.array([[0, 0, tangent[0]], [0, 0, tangent[1]], [-tangent[0], -tangent[1], 0]])
    turn = np.eye(3) + 2 / (1 + tangent @ tangent) * (across + across @ across)
    scale = np.diag([focal, focal, 1.0])
    return np.asarray(scale @ turn @ np.linalg.inv(scale))


def refined_motion(
    canvas: Canvas,
    frames: Array,
    weights: Array,
    spread_weights: Array,
    reference: int,
    free: int,
    curvature: float = 0.0,
) -> Array:
    """Motion (n, 3, 3) that registers frames with their mean on the canvas.

    Args:
        canvas: with the motion so far.
        frames: (n, h, w), corrected.
        weights: of the samples, same shape.
        spread_weights: the same on the canvas.
        reference: number of the frame that stays where it is.
        free: parameters: 3 for a turn of the camera, 8 for a homography.
        curvature: of a turn, see `turned`.
    """
    detail = frames - ndimage.gaussian_filter(frames, (0, REFINE_SIGMA, REFINE_SIGMA))
    motion, around = canvas.motion.copy(), copy.copy(canvas)
    y, x = (each.ravel() / (max(canvas.size) / 2) for each in centred(canvas.size))
    for _ in range(MAX_STEPS):
        scene = around.mean(detail, spread_weights)
        down, across = (around.predicted(each).reshape(len(motion), -1) for each in np.gradient(scene))
        rest = (detail - around.predicted(scene)).reshape(len(motion), -1)
        largest = 0.0
        for k, (gy, gx, missing, weight) in enumerate(zip(down, across, rest, weights, strict=True)):
            counts = weight.ravel() > 0
            if not counts.any():
                continue
            scale = MAD_TO_SIGMA * float(np.median(np.abs(missing[counts]))) + np.finfo(np.float32).tiny
            robust = counts / (1 + (missing / (OUTLIER_SIGMAS * scale)) ** 2)
            each = motion_gradients(gy, gx, y, x)
            if free == TURN:
                each = [each[0] + curvature * each[6], each[1] + curvature * each[7], each[2]]
            design = np.stack(each[:free])
            weighted = design * robust
            normal = weighted @ design.T
            normal[np.diag_indices(free)] += 1e-9 * np.trace(normal) + np.finfo(np.float32).tiny
            step = np.pad(np.linalg.solve(normal, weighted @ missing), (0, 8 - free))
            if free == TURN:
                step[6:] = curvature * step[:2]
            motion[k] = motion[k] @ _as_matrix(step, max(canvas.size) / 2)
            largest = max(largest, float(np.abs(step).max()))
        around.move(motion)
        spread_weights = around.spread_weights(weights)
        if largest < LAST_STEP:
            break
    return np.asarray(motion @ np.linalg.inv(motion[reference]))


def motion_gradients(gy: Array, gx: Array, y: Array, x: Array) -> list[Array]:
    """How a scene of a gradient changes with the eight parameters of a homography, at places in units of half a side.

    Shifts along x and y, turn, scale, stretch, shear, and the two of perspective; px at a distance of one.
    """
    along = gx * x + gy * y
    return [gx, gy, gy * x - gx * y, along, gx * x - gy * y, gx * y + gy * x, along * x, along * y]


def _as_matrix(step: Array, half: float) -> Array:
    """The homography (3, 3) of a small step of its parameters, see `motion_gradients`."""
    dx, dy, turn, scale, stretch, shear, over_x, over_y = step / half
    return np.array(
        [
            [1 + scale + stretch, shear - turn, dx * half],
            [shear + turn, 1 + scale - stretch, dy * half],
            [-over_x / half, -over_y / half, 1],
        ]
    )
