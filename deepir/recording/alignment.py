"""Motion of frames of one scene, once the fixed pattern is taken off: phase of shifts first, then Gauss-Newton steps.

Under a fixed pattern every registration finds no motion. A first estimate of the pattern, from the gradients that all
frames share, removes that bias, whatever the pattern's strength.

Frames are compared on a canvas: the reference frame's grid, extended by what the other frames see beyond it. Cubic
splines warp in both directions. Coordinates are px from the centre of a frame or of the canvas, x first.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.kernels import bspline
from deepir.kernels.compile import parallel_for, parallel_map

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
STRIDE = 3  # px, between samples that noise, scales and changes are measured in


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
        self.motion = np.ascontiguousarray(motion, float)
        self._to_frames: Array = np.linalg.inv(self.motion)

    def predicted(self, scene: Array) -> Array:
        """What frames (n, h, w) see of a scene (H, W)."""
        return _warped(spline(scene[None]), self.motion, self.size)

    def predicted_with_slopes(self, scene: Array) -> Array:
        """The same, and the scene's slopes down and across there, (3, n, h, w)."""
        out = np.empty((3, len(self.motion), *self.size), np.float32)
        parallel_for(bspline.warp_with_slopes, self.size[0], spline(scene[None])[0], self.motion, out)
        return out

    def spread(self, frames: Array) -> Array:
        """Frames (n or 1, h, w) on the canvas, (n, H, W)."""
        return _warped(spline(frames), self._to_frames, self.shape)

    def spread_weights(self, weights: Array) -> Array:
        """Weights of samples (n, h, w) on the canvas, (n, H, W); zero outside the frames."""
        inner = np.zeros_like(weights)
        inside = np.s_[:, BORDER:-BORDER, BORDER:-BORDER]
        inner[inside] = weights[inside]
        return _warped(inner, self._to_frames, self.shape)

    def mean(self, coefficients: Array, spread_weights: Array) -> Array:
        """Weighted mean (H, W), on the canvas, of frames (n or 1, h, w); zero where no frame counts.

        Args:
            coefficients: of the frames, see `spline`.
            spread_weights: (n, H, W).
        """
        out = np.empty(self.shape, np.float32)
        parallel_for(bspline.mean, self.shape[0], coefficients, spread_weights, self._to_frames, out)
        return out

    def is_seen(self, spread_weights: Array) -> Array:
        """Samples (n, h, w) whose place on the canvas some frame shows, bool."""
        known = np.asarray((spread_weights > 0).any(0), np.float32)
        return np.asarray(_warped(known[None], self.motion, self.size) > MIN_SEEN)


def _warped(coefficients: Array, motion: Array, shape: tuple[int, int]) -> Array:
    """Images (n, *shape) of coefficients (n or 1, h, w), by motion (n, 3, 3) to these."""
    out = np.empty((len(motion), 1, *shape), np.float32)
    parallel_for(bspline.warp, shape[0], coefficients[:, None], motion, out)
    return out[:, 0]


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


def spline(images: Array) -> Array:
    """Coefficients of the cubic splines through samples (N, h, w), float32."""
    return _on_each(functools.partial(ndimage.spline_filter, order=3, mode="mirror"), images)


def smoothed(images: Array, sigma: float) -> Array:
    """Means of images (N, h, w) under a Gaussian, px; float32."""
    return _on_each(functools.partial(ndimage.gaussian_filter, sigma=sigma), images)


def _on_each(function: Callable[..., Array], images: Array) -> Array:
    out = np.empty(images.shape, np.float32)
    parallel_map(lambda k: function(images[k], output=out[k]), range(len(images)))
    return out


def corners(motion: Array, size: Sequence[int]) -> Array:
    """Rows and columns (n, 2, 4) to which motion (n, 3, 3) takes the corners of frames (h, w)."""
    y, x = (each[:: size[0] - 1, :: size[1] - 1].ravel() for each in centred(size))
    return np.stack([np.stack(project(each, y, x)) for each in motion])


class Window:
    """The window of frames that are correlated, (h, w), padded by zeros to `padded`, px.

    Attributes:
        spectrum: its transform.
        overlap: of two windows, by the shift between them.
    """

    def __init__(self, size: tuple[int, ...]) -> None:
        height, width = size
        self.padded = fft.next_fast_len(int(PADDING * height)), fft.next_fast_len(int(PADDING * width))
        self.values = np.sqrt(np.outer(*(np.hanning(side + 2)[1:-1] for side in size))).astype(np.float32)
        self.spectrum = fft.rfft2(self.values, self.padded)
        self.overlap = self.correlation(self.spectrum, self.spectrum)

    def correlation(self, one: Array, other: Array) -> Array:
        """Of two by their spectra, by the shift from the other to the one."""
        return np.asarray(fft.irfft2(np.conj(other) * one, self.padded))


_window = functools.lru_cache(maxsize=1)(Window)


@dataclass(frozen=True)
class Spectrum:
    """Transforms of a windowed frame and of its square, for masked correlation."""

    frame: Array
    square: Array
    window: Window

    @classmethod
    def of(cls, frame: Array) -> Spectrum:
        """Of a frame (h, w), less its low-order part; limited, as a hot person who walks would outweigh the scene."""
        window = _window(frame.shape)
        detail = frame - ndimage.gaussian_filter(frame, SHIFT_SIGMA)
        detail = detail.clip(*np.quantile(np.abs(detail), LIMIT) * np.array([-1, 1]))
        shown, square = (fft.rfft2(part * window.values, window.padded) for part in (detail, detail**2))
        return cls(shown, square, window)


def find_shift(reference: Spectrum, frame: Spectrum) -> tuple[Array, float]:
    """The shift (x, y), px, from a frame to the reference, and the correlation there, at most one.

    Source: Padfield, "Masked object registration in the Fourier domain", IEEE Trans. Image Process. 21, 2012.
    """
    window = frame.window
    energy = np.sqrt(
        np.maximum(window.correlation(reference.square, window.spectrum), 0)
        * np.maximum(window.correlation(window.spectrum, frame.square), 0)
    )
    is_wide = (window.overlap > MIN_OVERLAP * window.overlap.max()) & (energy > 1e-3 * energy.max())
    score = np.where(is_wide, window.correlation(reference.frame, frame.frame) / np.where(is_wide, energy, 1), -1.0)
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
    detail = frames - smoothed(frames, REFINE_SIGMA)
    coefficients, counts, basis = spline(detail), (weights > 0).astype(np.float32), np.eye(8)[:free]
    if free == TURN:
        basis[:2, 6:] = curvature * np.eye(2)
    motion, around, half = canvas.motion.copy(), copy.copy(canvas), max(canvas.size) / 2
    steps, taken = list[Array](), list[Array]()
    for _ in range(MAX_STEPS):
        shown, down, across = around.predicted_with_slopes(around.mean(coefficients, spread_weights))
        rest = np.subtract(detail, shown, out=shown)
        robust = _robust_weights(rest, counts)
        normal = basis @ _normal_of_steps(down, across, robust) @ basis.T
        normal += (1e-9 * np.trace(normal, axis1=1, axis2=2) + np.finfo(np.float32).tiny)[:, None, None] * np.eye(free)
        rest *= robust
        score = _moments_of_steps(down * rest, across * rest) @ basis.T
        steps.append(np.linalg.solve(normal, score[..., None])[..., 0] @ basis)
        taken.append(_accelerated(steps, taken))
        motion = motion @ np.stack([_as_matrix(each, half) for each in taken[-1]])
        around.move(motion)
        if np.abs(steps[-1]).max() < LAST_STEP:
            break
    return np.asarray(motion @ np.linalg.inv(motion[reference]))


def _accelerated(steps: Sequence[Array], taken: Sequence[Array]) -> Array:
    """The change (n, 8) that takes the place of the last step: each step is of one frame, as if all others were right.

    Source: Anderson, "Iterative procedures for nonlinear integral equations", J. ACM 12, 1965.
    """
    if not taken:
        return steps[-1]
    scale = 1 / np.maximum(np.linalg.norm(steps[-1], axis=1, keepdims=True), LAST_STEP)  # no frame outweighs the others
    changes = np.diff(np.stack(steps), axis=0)  # of which those that are nearly alike differ by noise
    share = np.linalg.lstsq((scale * changes).reshape(len(taken), -1).T, (scale * steps[-1]).ravel(), rcond=0.1)[0]
    return np.asarray(steps[-1] - np.tensordot(share, np.stack(taken) + changes, 1))


def _robust_weights(rest: Array, counts: Array) -> Array:
    """Cauchy's weights of residuals (n, h, w), by each frame's own scale; zero where a sample does not count."""
    weights = np.zeros_like(rest)
    some = np.s_[::STRIDE, ::STRIDE]
    for each, counted, weight in zip(rest, counts, weights, strict=True):
        known = np.abs(each[some][counted[some] > 0])
        if known.size:
            scale = OUTLIER_SIGMAS * MAD_TO_SIGMA * float(np.median(known)) + np.finfo(np.float32).tiny
            weight[:] = counted / (1 + (each / np.float32(scale)) ** 2)
    return weights


ONE, X, XX, Y, XY, _, YY, _, _ = np.eye(9).reshape(9, 3, 3)  # monomials, as coefficients of powers of y and of x
#: Displacements by each parameter of a homography, (8, 2, 3, 3), down and across: shifts along x and y, turn, scale,
#: stretch, shear, and the two of perspective; px at half a side from the centre.
POLYNOMIALS = np.array([(0 * ONE, ONE), (ONE, 0 * ONE), (X, -Y), (Y, X), (-Y, X), (X, Y), (XY, XX), (YY, XY)])


def step_gradients(gy: Array, gx: Array, y: Array, x: Array) -> Array:
    """How a scene of slopes (gy, gx) changes with each parameter of a homography, (8, ...), at places in half sides."""
    powers = np.stack([[y**i * x**j for j in range(3)] for i in range(3)])
    return np.asarray(np.einsum("dp,kdij,ijp->kp", np.stack([gy, gx]), POLYNOMIALS, powers, optimize=True))


def _moments_of_steps(down: Array, across: Array) -> Array:
    """Sums (n, 8), over the displacements by each parameter, of a quantity (n, h, w), down and across."""
    moments = np.stack([_moments(each, 3) for each in (down, across)])
    return np.einsum("dnij,kdij->nk", moments, POLYNOMIALS)


def _normal_of_steps(down: Array, across: Array, weights: Array) -> Array:
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


def _as_matrix(step: Array, half: float) -> Array:
    """The homography (3, 3) of a step of the parameters, px, in a frame of half a side, px."""
    dx, dy, turn, scale, stretch, shear, over_x, over_y = step / half
    return np.array(
        [
            [1 + scale + stretch, shear - turn, dx * half],
            [shear + turn, 1 + scale - stretch, dy * half],
            [-over_x / half, -over_y / half, 1],
        ]
    )
