"""The frames of one scene in the solve for their sensor: their motion, levels, gains, weights, and what they tell."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.arrays.statistics import CHI_SQUARED_MEDIAN, MAD_TO_SIGMA
from deepir.recording.alignment import motion_gradients, refined_motion
from deepir.recording.canvas import Canvas, centred, project
from deepir.recording.low_order import LowOrderModes, NormalEquations, block_sums, low_order_equations
from deepir.recording.offset_prior import dct, group_power, mode_radius

Array = np.ndarray[Any, Any]

OUTLIER_SIGMAS = 3.0  # of residuals, scale of Cauchy's weights
WEIGHT_SIGMA = 1.5  # px, Gaussian over which residuals are averaged that set weights
#: Variances of a step of the levels, relative to that of a sample's noise, of which the likeliest is taken.
LEVEL_VARIANCES = 10.0 ** np.arange(-5, 3)
SHIFT_ERROR = 0.05  # px, standard deviation of the motion once it is refined
#: Of the error of the motion, that all frames have in common: relative to the motion, the share of the scene that stays
#: in the offset.
COMMON_SHARE = 0.15
STEEP = 0.9  # quantile of the scene's slope, from which samples tell the error of the motion
#: px, standard deviation of the shifts along an axis, from which they tell what varies along it.
MIN_MOTION = 0.1
SAMPLE_STRIDE = 2  # px, of the samples that the noise is measured in


class Burst:
    """Frames of one scene.

    Args:
        frames: (n, h, w), float32, in their order; finite.
        usable: same shape, bool.
        motion: (n, 3, 3), to the reference frame.
        reference: its number.
        curvature: of the motion, see `deepir.recording.alignment`.
        gains_differ: whether an automatic gain control may change the frames' gains.
    """

    def __init__(
        self,
        frames: Array,
        usable: Array,
        motion: Array,
        reference: int,
        *,
        curvature: float = 0.0,
        gains_differ: bool = False,
    ) -> None:
        self.frames, self.usable, self.reference = frames, usable.astype(np.float32), reference
        self.curvature = curvature
        self.gains_differ = gains_differ
        self.canvas = Canvas(motion, (frames.shape[1], frames.shape[2]))
        self.levels, self.gains = np.zeros(len(frames)), np.ones(len(frames))
        self.weights, self.spread_weights = self.usable, self.canvas.spread_weights(self.usable)
        self.noise, self.level_variance, self.inflation, self.motion_error = 1.0, 0.0, 1.0, 0.0
        self.level_variances: Sequence[float] = ()
        self.common_error = np.zeros(self.canvas.size)

    def corrected(self, offset: Array, gain: Array) -> Array:
        """Frames (n, h, w) without pattern and level."""
        levels, gains = (np.asarray(each, np.float32)[:, None, None] for each in (self.levels, self.gains))
        return np.asarray(
            (self.frames / gains - levels - offset.astype(np.float32)) / gain.astype(np.float32)
        )

    def align(self, offset: Array, gain: Array, free: int) -> None:
        """Refine the motion."""
        frames = self.corrected(offset, gain)
        found = refined_motion(
            self.canvas, frames, self.weights, self.spread_weights, self.reference, free, self.curvature
        )
        self.canvas.move(found)
        self.spread_weights = self.canvas.spread_weights(self.weights)

    def weigh(self, offset: Array, gain: Array, motion_error: float, *, robust: bool) -> None:
        """Set the noise, and the weights of the samples: by the noise, by errors of motion at edges, by outliers."""
        frames = self.corrected(offset, gain)
        scene = self.canvas.mean(frames, self.spread_weights)
        rest = frames - self.canvas.predicted(scene)
        seen = self.usable * self.canvas.is_seen(self.spread_weights)
        some = np.s_[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE]
        counted = np.abs(rest[some][seen[some] > 0])
        self.noise = max(MAD_TO_SIGMA * float(np.median(counted)) if counted.size else 0.0, 1e-6)
        down, across = (self.canvas.predicted(each) for each in np.gradient(scene))
        steepness = down**2 + across**2
        self.motion_error = _motion_error(rest[some], steepness[some], seen[some] > 0)
        variance = self.noise**2 + motion_error**2 * _smoothed(steepness)
        weights = seen / variance
        if robust:
            weights = weights / (1 + _smoothed(rest**2) / (OUTLIER_SIGMAS**2 * variance))
        self.weights = weights.astype(np.float32)
        # A gain control sets the levels too.
        free = LEVEL_VARIANCES[-1:] if self.gains_differ else LEVEL_VARIANCES
        self.level_variances = (free * self.noise**2).tolist()
        y, x = (each.astype(np.float32) / (max(self.canvas.size) / 2) for each in centred(self.canvas.size))
        self.phase_change = phase_change(self.canvas.motion, self.canvas.size)
        shown = group_power(dct(self.canvas.predicted(scene)[self.reference].astype(float)))
        frequency = np.pi * mode_radius(self.canvas.size) / max(self.canvas.size)  # radian / px
        common = COMMON_SHARE * self.motion_error * frequency
        self.common_error = shown * common**2 / self.phase_change
        shifts = np.eye(3) + self.canvas.motion * (np.arange(3) == 2) * (np.arange(3)[:, None] < 2)
        least = 1 - np.exp(-((MIN_MOTION * frequency) ** 2))
        self.tells = phase_change(shifts, self.canvas.size) > least
        self._motions = np.stack(motion_gradients(down, across, y, x), 1)
        normal = np.einsum("kihw,kjhw,khw->kij", self._motions, self._motions, self.weights, optimize=True)
        self._motion_covariance = np.linalg.inv(normal.astype(float) + np.eye(8) / SHIFT_ERROR**2)
        self.spread_weights = self.canvas.spread_weights(self.weights)

    def compared(self, offset: Array, gain: Array) -> tuple[Array, Array]:
        """Frames (n, h, w) without pattern and level, and what the other samples of the scene expect of them."""
        frames = self.corrected(offset, gain)
        expected = self.canvas.predicted(self.canvas.mean(frames, self.spread_weights))
        return frames, np.where(self.canvas.is_seen(self.spread_weights), expected, frames)

    def score(self, frames: Array) -> Array:
        """Sum (h, w) over frames (n or 1, h, w) of their weighted differences to their mean scene."""
        scene = self.canvas.mean(frames, self.spread_weights)
        rest = self.weights * (frames - self.canvas.predicted(scene))
        moved = np.einsum("kij,kjhw,khw->ki", self._motion_covariance, self._motions, rest, optimize=True)
        rest -= self.weights * np.einsum("ki,kihw->khw", moved.astype(np.float32), self._motions)
        return np.asarray(rest.sum(0, dtype=float)) / self.inflation

    def equations(self, modes: LowOrderModes, offset: Array, gain: Array) -> NormalEquations:
        """Of the low-order part."""
        spread = self.canvas.spread(self.corrected(offset, gain))
        return low_order_equations(
            spread,
            self.spread_weights,
            functools.partial(self._places, modes.block),
            modes,
            offset if self.gains_differ else None,
            with_motion=True,
        )

    def _places(self, block: int, k: int, seen: Array) -> tuple[Array, Array]:
        """Rows and columns of a frame, px, that blocks of the canvas show."""
        y, x = (block_sums(each, block)[seen] / block**2 for each in centred(self.canvas.shape))
        y, x = project(np.linalg.inv(self.canvas.motion[k]), y, x)
        return y + (self.canvas.size[0] - 1) / 2, x + (self.canvas.size[1] - 1) / 2


def _motion_error(rest: Array, steepness: Array, seen: Array) -> float:
    """Error of the motion, px, by which residuals (n, h, w) at steep places of the scene exceed those at flat ones."""
    if not seen.any():
        return 0.0
    rest, steepness = rest[seen] ** 2, steepness[seen]
    flat, steep = steepness < np.median(steepness), steepness > np.quantile(steepness, STEEP)
    if not (flat.any() and steep.any()):
        return 0.0
    excess = float(np.median(rest[steep]) - np.median(rest[flat])) / CHI_SQUARED_MEDIAN
    return max(excess / float(np.median(steepness[steep])), 0.0) ** 0.5


def _smoothed(values: Array) -> Array:
    """Means (n, h, w) around each sample: weights that change from pixel to pixel do not survive interpolation."""
    return np.asarray(ndimage.gaussian_filter(values, (0, WEIGHT_SIGMA, WEIGHT_SIGMA)))


def phase_change(motion: Array, size: Sequence[int]) -> Array:
    """How the phase of each mode (h, w) differs between frames, from 0 to 1: one that looks alike is the scene's."""
    down, across = (np.pi * np.arange(side) / side for side in size)
    same = []
    for y in (-size[0] / 4, size[0] / 4):
        for x in (-size[1] / 4, size[1] / 4):
            moved = motion @ np.array([x, y, 1.0])
            shift = moved[:, :2] / moved[:, 2:] - (x, y)
            of_rows, of_columns = np.exp(1j * down * shift[:, 1:]), np.exp(1j * across * shift[:, :1])
            same += [
                np.abs(np.einsum("kh,kw->hw", phase, of_columns) / len(shift)) ** 2
                for phase in (of_rows, np.conj(of_rows))
            ]
    return np.asarray(np.maximum(1 - np.mean(same, 0), 1e-6))
