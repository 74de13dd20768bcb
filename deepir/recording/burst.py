"""The frames of a recording that show one scene: their motion, levels, gains, weights, and what they tell."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import CHI_SQUARED_MEDIAN, MAD_TO_SIGMA, block_sums
from deepir.errors import DataError
from deepir.kernels.compile import parallel_map
from deepir.multiview.pattern_gradients import gradient_consensus
from deepir.recording.alignment import (
    REFINE_SIGMA,
    STRIDE,
    TURN,
    Canvas,
    Links,
    Spectrum,
    centred,
    corners,
    project,
    refined_motion,
    smoothed,
    spline,
)
from deepir.recording.defective_pixels import noise_deviation
from deepir.recording.modes import (
    LowOrderModes,
    NormalEquations,
    dct,
    directional_groups,
    group_power,
    low_order_equations,
    mode_radius,
)

OUTLIER_SIGMAS = 3.0  # of residuals, scale of Cauchy's weights
#: px, Gaussian over which residuals are averaged that set weights: those that change from pixel to pixel do not survive
#: interpolation.
WEIGHT_SIGMA = 1.5
#: Mean around a sample, in deviations of one, from which it shows what moves by itself. In 44 hand-held recordings
#: (bench, seeds 0, 1 and 4) at most 0.014 % of the samples exceed it where nothing moves; with a person 0.1 to 5 %.
OUTSTANDING = 4.0
#: Variances of a step of the levels, relative to that of a sample's noise, of which the likeliest is taken.
LEVEL_VARIANCES = 10.0 ** np.arange(-5, 3)
#: Of the error of the motion, that all frames have in common: relative to the motion, the share of the scene that stays
#: in the offset.
COMMON_SHARE = 0.15
CONTRAST_ERROR = 0.01  # of a frame's gain under a gain control, as its finest detail tells it
STEEP = 0.9  # quantile of the scene's slope, from which samples tell the error of the motion
MIN_MOTION = 0.1  # px, standard deviation of the motion along an axis, from which it tells what varies along it
CANDIDATES = 48  # frames that are registered to a reference, at most
FRAMES = 24  # of a burst, at most
MIN_LIKENESS = 0.4  # correlation with the frames that it is registered to, of a frame that is used
MAX_REACH = 0.5  # of the sides: how far a frame of a burst is from the reference
#: Squared tangents of half a camera's field of view that are tried, from a telephoto lens to 80 degrees.
CURVATURES = (0.0, 0.06, 0.12, 0.2, 0.35, 0.7)
REST_SIGMAS = 1.2  # of `changes`, below which nothing has moved
TRIAL_FRAMES = 8  # of a burst, that curvatures are tried on
MIN_FRAMES = 4  # of a burst
MIN_STEP = 0.5  # px: frames that moved by less since another one add nothing but an average
AT_REST = (
    "the camera stands still in most of the recording, or sees little but a wall or the sky, so that scene and fixed "
    "pattern cannot be separated. Move the camera over something with edges, or apply (deepir apply) the maps that "
    "another recording of this camera gave, or one of a uniform wall (deepir calibrate)"
)


class CameraAtRestError(DataError):
    """The camera stands still."""


@dataclass(frozen=True)
class FramePrior:
    """Of what frames have of their own, beside their motion.

    Attributes:
        level_variance: of a step of the level from frame to frame.
        gains: of the frames, (n,).
        gain_variance: of these gains; zero: they are known.
    """

    level_variance: float
    gains: Array
    gain_variance: float = 0.0


class Burst:
    """Frames of one scene.

    Args:
        frames: (n, h, w), float32, in their order; finite.
        usable: same shape, bool.
        motion: (n, 3, 3), to the reference frame.
        reference: its number.
        curvature: of the motion, see `deepir.recording.alignment`.
        contrasts: (n,), gains of the frames, as their finest detail tells them.
    """

    independent = True  # of other bursts

    def __init__(
        self, frames: Array, usable: Array, motion: Array, reference: int, contrasts: Array, *, curvature: float = 0.0
    ) -> None:
        self.frames, self.usable, self.reference = frames, usable.astype(np.float32), reference
        self.curvature, self.contrasts = curvature, contrasts
        self.canvas = Canvas(motion, (frames.shape[1], frames.shape[2]))
        self.levels, self.gains = np.zeros(len(frames)), contrasts
        self.weights, self.spread_weights = self.usable, self.canvas.spread_weights(self.usable)
        self.noise, self.inflation, self.motion_error = 1.0, 1.0, 0.0
        self.frame_prior = FramePrior(0.0, contrasts, CONTRAST_ERROR**2)  # gains differ until the frames say no
        self.frame_priors = [self.frame_prior]
        self.common_error = np.zeros(self.canvas.size)

    def enlarged(self, frames: Array, usable: Array, factor: int) -> Burst:
        """The burst of the frames (n, h, w) that this one has means of, over blocks of `factor` px."""
        down, across = ((factor * (side // factor) - side) / 2 for side in frames.shape[1:])
        scale = np.array([[factor, 0, across], [0, factor, down], [0, 0, 1.0]])
        motion = scale @ self.canvas.motion @ np.linalg.inv(scale)
        whole = Burst(frames, usable, motion, self.reference, self.gains, curvature=self.curvature)
        whole.levels = self.levels
        return whole

    def corrected(self, offset: Array, gain: Array) -> Array:
        """Frames (n, h, w) without pattern and level."""
        levels, gains = (np.asarray(each, np.float32)[:, None, None] for each in (self.levels, self.gains))
        return np.asarray((self.frames / gains - levels - offset.astype(np.float32)) / gain.astype(np.float32))

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
        shown, down, across = self.canvas.predicted_with_slopes(self._scene(frames))
        rest = frames - shown
        seen = self.usable * self.canvas.is_seen(self.spread_weights)
        some = np.s_[:, ::STRIDE, ::STRIDE]
        counted = np.abs(rest[some][seen[some] > 0])
        self.noise = max(MAD_TO_SIGMA * float(np.median(counted)) if counted.size else 0.0, 1e-6)
        steepness = down**2 + across**2
        self.motion_error = _motion_error(rest[some], steepness[some], seen[some] > 0)
        variance = self.noise**2 + motion_error**2 * smoothed(steepness, WEIGHT_SIGMA)
        weights = seen / variance
        if robust:
            weights = weights / (1 + smoothed(rest**2, WEIGHT_SIGMA) / (OUTLIER_SIGMAS**2 * variance))
        self.weights = weights.astype(np.float32)
        levels = LEVEL_VARIANCES * self.noise**2
        self.frame_priors = [FramePrior(each, np.ones_like(self.gains)) for each in levels]
        if self.frame_prior.gain_variance:  # a gain control sets the levels too
            self.frame_priors.append(FramePrior(levels[-1], self.contrasts, CONTRAST_ERROR**2))
        self.phase_change = phase_change(self.canvas.motion, self.canvas.size)
        frequency = np.pi * mode_radius(self.canvas.size) / max(self.canvas.size)  # radian / px
        common = COMMON_SHARE * self.motion_error * frequency
        self.scene_modes = dct(shown[self.reference].astype(float))
        self.scene_power = group_power(self.scene_modes, directional_groups(self.canvas.size))
        self.common_error = self.scene_power * common**2 / self.phase_change
        least = 1 - np.exp(-((MIN_MOTION * frequency) ** 2))
        self.tells = phase_change(_rigid(self.canvas.motion), self.canvas.size) > least
        self.spread_weights = self.canvas.spread_weights(self.weights)

    def compared(self, offset: Array, gain: Array) -> tuple[Array, Array]:
        """Frames (n, h, w) without pattern and level, and what the other samples of the scene expect of them."""
        frames = self.corrected(offset, gain)
        seen = self.canvas.is_seen(self.spread_weights)
        return frames, np.where(seen, self.canvas.predicted(self._scene(frames)), frames)

    def moving_share(self, rest: Array) -> float:
        """Share of the samples (n, h, w) that show what moves by itself, by what they have beside their scene.

        Where the place of an edge is uncertain, all frames differ. What moves by itself is at a point of the scene in
        few frames, and the others agree: so `rest` is compared with the deviation of all frames at a point.
        """
        shown = self.canvas.spread_weights(self.usable) > 0.5
        shown &= shown.sum(0) >= MIN_FRAMES
        apart = np.ma.masked_array(self.canvas.spread(rest), ~shown)
        apart -= np.ma.median(apart, axis=0)
        deviation = MAD_TO_SIGMA * np.ma.median(np.abs(apart), axis=0).filled(0.0)
        usual = smoothed(np.maximum(deviation, self.noise)[None], WEIGHT_SIGMA)
        moves = np.abs(smoothed(apart.filled(0.0), WEIGHT_SIGMA)) > OUTSTANDING * usual
        return float(moves[shown].sum() / max(shown.sum(), 1))

    def score(self, frames: Array) -> Array:
        """Sum (h, w) over frames (n or 1, h, w) of their weighted differences to their mean scene."""
        rest = self.weights * (frames - self.canvas.predicted(self._scene(frames)))
        return np.asarray(rest.sum(0, dtype=float)) / self.inflation

    def equations(self, modes: LowOrderModes, offset: Array, gain: Array) -> NormalEquations:
        """Of the low-order part."""
        spread = self.canvas.spread(self.corrected(offset, gain))
        return low_order_equations(
            spread, self.spread_weights, functools.partial(self._places, modes.block), modes, offset, with_motion=True
        )

    def _scene(self, frames: Array) -> Array:
        """Mean (H, W) of frames (n or 1, h, w) on the canvas."""
        return self.canvas.mean(spline(frames), self.spread_weights)

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


def _rigid(motion: Array) -> Array:
    """Shift and turn of homographies (n, 3, 3) that are near one; the rest of them is small, and mostly error."""
    turn = np.arctan2(motion[:, 1, 0] - motion[:, 0, 1], motion[:, 0, 0] + motion[:, 1, 1])
    found = np.tile(np.eye(3), (len(motion), 1, 1))
    found[:, 0, 0] = found[:, 1, 1] = np.cos(turn)
    found[:, 1, 0] = np.sin(turn)
    found[:, 0, 1] = -found[:, 1, 0]
    found[:, :2, 2] = motion[:, :2, 2]
    return found


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


def _frames_alike(frames: Array, around: int, pattern: Array) -> tuple[Array, Array, Links] | None:
    """Frames (N, h, w) that show what the one of number `around` does, less a pattern; None where too few do.

    Returns:
        The numbers of the frames that are compared, the places of the chosen ones among these, and the links of all.

    Raises:
        CameraAtRestError: Most frames show the same at the same place.
    """
    step = -(-len(frames) // CANDIDATES)
    numbers, size = np.arange(around % step, len(frames), step), frames.shape[1:]
    reference = around // step
    links = Links.of(parallel_map(lambda k: Spectrum.of(frames[k] - pattern), numbers.tolist()), reference)
    motion = links.motion(0.0, max(size) / 2)
    stays = changes(frames[numbers], [(k, reference) for k in range(len(numbers))], pattern) < REST_SIGMAS
    if stays.mean() > 0.5:
        raise CameraAtRestError(AT_REST)
    motion[stays] = np.eye(3)
    near = (np.abs(motion[:, :2, 2]) < MAX_REACH * np.array(size[::-1])).all(1)
    alike = (links.likeness >= MIN_LIKENESS) & near
    chosen = _apart(motion, alike, reference, size)
    if len(chosen) >= MIN_FRAMES:
        return numbers, chosen, links
    still = np.abs(motion[:, :2, 2]).max(1) < MIN_STEP  # alike or not: the pattern so far may hold most of the scene
    if (alike | still).sum() >= max(MIN_FRAMES, len(numbers) / 2):
        raise CameraAtRestError(AT_REST)
    return None


@dataclass(frozen=True)
class Bursts:
    """Bursts, each of one scene, and the numbers of the frames of each."""

    bursts: list[Burst]
    frames: list[Array]

    @property
    def numbers(self) -> Array:
        """Of all frames."""
        return np.concatenate(self.frames)


def find_burst(frames: Array, usable: Array, around: int, start: Array, contrasts: Array) -> Bursts | None:
    """Frames that show the scene of a reference, as far apart as they are; None where too few do.

    Args:
        frames: (N, h, w), float32.
        usable: same shape, bool.
        around: number of the reference.
        start: (h, w), a pattern that is taken off before frames are compared.
        contrasts: (N,), gains of the frames, as their finest detail tells them.

    Raises:
        CameraAtRestError: Most frames show the same at the same place.
    """
    even = _evened(frames, contrasts)
    first = _frames_alike(even, around, start.astype(np.float32))
    if first is None:
        return None
    numbers, chosen, _ = first
    pattern = gradient_consensus(even[numbers[chosen]], usable[numbers[chosen]])
    numbers, chosen, links = _frames_alike(even, around, pattern) or first
    kept, half = numbers[chosen], max(frames.shape[1:]) / 2
    reference = int(np.searchsorted(kept, around))
    few = np.unique(np.append(np.arange(0, len(kept), -(-len(kept) // TRIAL_FRAMES)), reference))
    known, detail = usable[kept[few]].astype(np.float32), even[kept[few]] - pattern
    place = int(np.searchsorted(few, reference))
    trials = [_misfit(detail, known, links.motion(each, half)[chosen][few], place, each) for each in CURVATURES]
    curvature = CURVATURES[int(np.argmin(trials))]
    motion = links.motion(curvature, half)[chosen]
    burst = Burst(frames[kept], usable[kept], motion, reference, contrasts[kept], curvature=curvature)
    return Bursts([burst], [kept])


def short_bursts(
    frames: Array, usable: Array, stretches: Sequence[Array], start: Array, contrasts: Array
) -> Bursts | None:
    """Frames of short stretches of a recording, within which near and far things move nearly alike; None of one.

    Args:
        frames, usable: (N, h, w), float32 and bool.
        stretches: numbers of the frames of each.
        start: (h, w), a pattern that is taken off before frames are compared.
        contrasts: (N,), gains of the frames, as their finest detail tells them.
    """
    half, even = max(frames.shape[1:]) / 2, _evened(frames, contrasts)

    def burst(stretch: Array) -> tuple[Burst, Array] | None:
        middle = len(stretch) // 2
        try:
            found = _frames_alike(even[stretch], middle, start.astype(np.float32))
        except CameraAtRestError:
            return None
        if found is None:
            return None
        numbers, chosen, links = found
        reference, motion = int(np.searchsorted(numbers[chosen], middle)), links.motion(0.0, half)[chosen]
        numbers = stretch[numbers[chosen]]
        return Burst(frames[numbers], usable[numbers], motion, reference, contrasts[numbers]), numbers

    found = [each for each in parallel_map(burst, stretches) if each is not None]
    return Bursts(*map(list, zip(*found, strict=True))) if len(found) > 1 else None


def _evened(frames: Array, contrasts: Array) -> Array:
    return np.asarray(frames / contrasts.astype(np.float32)[:, None, None])


def changes(frames: Array, pairs: Sequence[tuple[int, int]], pattern: Array) -> Array:
    """Upper quartile of the change of each pair of frames (n, h, w), less its level, in sigmas of its noise.

    1.15 where nothing moves. The noise is that of the frames without what they share, `pattern` (h, w).
    """
    some = frames[:, ::STRIDE, ::STRIDE].reshape(len(frames), -1)
    found = np.stack([some[i] - some[j] for i, j in pairs])
    found = np.abs(found - np.median(found, axis=1, keepdims=True))
    return np.asarray(np.quantile(found, 0.75, axis=1) / (2**0.5 * noise_deviation(frames - pattern)))


def _misfit(frames: Array, known: Array, motion: Array, reference: int, curvature: float) -> float:
    """Mean misfit of frames to their mean scene, once their motion is refined; inf where that is far off."""
    size = (frames.shape[1], frames.shape[2])
    if not _is_near(motion, size):
        return np.inf
    canvas = Canvas(motion, size)
    spread = canvas.spread_weights(known)
    canvas.move(refined_motion(canvas, frames, known, spread, reference, TURN, curvature))
    if not _is_near(canvas.motion, size):
        return np.inf
    weights = canvas.spread_weights(known)
    detail = frames - smoothed(frames, REFINE_SIGMA)
    rest = detail - canvas.predicted(canvas.mean(spline(detail), weights))
    return float(np.abs(rest)[canvas.is_seen(weights) & (known > 0)].mean())


def _is_near(motion: Array, size: tuple[int, int]) -> bool:
    """Whether all corners of all frames lie within a side of the reference frame."""
    return bool((np.abs(corners(motion, size)).max((0, 2)) < 1.5 * np.array(size)).all())


def _apart(motion: Array, allowed: Array, reference: int, size: tuple[int, ...]) -> Array:
    """Frames whose motion is far from each other's, the reference first; sorted numbers."""
    places = corners(motion, size).reshape(len(motion), -1) / 2
    chosen = [reference]
    distance = np.where(allowed, np.linalg.norm(places - places[reference], axis=1), 0.0)
    while len(chosen) < FRAMES and distance.max() > MIN_STEP:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.sort(chosen)
