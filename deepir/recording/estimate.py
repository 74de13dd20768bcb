"""Gain, offset and bad pixels of a camera from the keyframes of a recording.

Frames that register as a whole, or else within short stretches, are solved together with their scenes (`joint_solve`).
Among near things they do not: dense displacements tell the low-order part, frames of different scenes the fine one
(`displaced`). What none of these determines is left as it is.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import CHI_SQUARED_MEDIAN, block_means, block_sums
from deepir.calibration import CorrectionMaps
from deepir.errors import DataError
from deepir.io.inspection.samples import saturated_samples
from deepir.kernels.compile import parallel_map
from deepir.messages import Message
from deepir.multiview.pattern_gradients import gradient_consensus
from deepir.multiview.texture_flow import coarsening, enlarged
from deepir.recording.burst import AT_REST, MIN_FRAMES, Bursts, CameraAtRestError, changes, find_burst, short_bursts
from deepir.recording.defective_pixels import (
    FRAMES,
    defective_pixels,
    noise_deviation,
    of_neighbours,
    rounding_deviation,
)
from deepir.recording.displaced import fine_part, low_order_part, solve_low_order
from deepir.recording.joint_solve import MAX_INFLATION, MOTION_ERRORS, SensorSolution, solve_sensor
from deepir.recording.keyframes import Keyframes, spread

FINE_OFFSET = "fine offset"  # what is corrected where the shading stays
SAMPLE_STRIDE = 4  # px, between samples that a median is taken of
#: Long periods of the frames' mean without the offset, relative to those with it, from which the offset is the scenes':
#: both would cancel by a correlation of -0.64. Hand-held and under gain control 0.15 to 1.08, small drives 1.5 to 3.
MAX_CANCELLATION = 1.3
#: What is said: share of the samples that show what moves by itself, and deviation of the low-order part, relative to
#: it: 0.06 to 0.33 where 0.04 to 0.28 are left (hand-held, seeds 6 and 10), 0.06 to 0.29 where 0.2 to 0.5 (trembles).
MIN_MOVING, UNCERTAIN = 0.001, 0.1
MIN_CHANGE_SIGMAS = 2.2  # of `changes` between keyframes, below which nothing has moved
MAX_CHANGE = 2.0  # of the mean residual at a jump, in its variances, up to which one pattern fits both sides
#: How a camera moves along one axis alone, where its shading is not separated, and what to do.
ONE_WAY = (
    ("turns sideways only", "from top to bottom", "Tilt the camera too"),
    ("tilts only", "from left to right", "Turn the camera sideways too"),
)


@dataclass(frozen=True)
class SensorEstimate:
    """Estimate of the sensor of a recording: `frame = level + offset + gain (scene - level)`.

    Attributes:
        gain: (h, w), around one.
        offset: (h, w), frames' units, mean zero.
        bad_pixels: (h, w) bool.
        level: frames' units, the median of the frames.
        offset_deviation: (h, w), posterior standard deviation of the offset; None where it is not known.
        kept: what is corrected, in words.
        motion_error: of registered frames, px; inf where they do not register.
        messages: for the user.
        contrasts: numbers of frames, and their gains by an automatic gain control, relative to their mean; None: one.
        jumps: numbers of frames at which the pattern may jump, as far as registered frames do not rule it out.
        noise: standard deviation of a sample's noise, frames' units; NaN where it is not known.
    """

    gain: Array
    offset: Array
    bad_pixels: Array
    level: float
    offset_deviation: Array | None
    kept: str
    motion_error: float
    messages: tuple[str, ...] = ()
    contrasts: tuple[Array, Array] | None = None
    jumps: tuple[int, ...] = ()
    noise: float = np.nan

    @property
    def is_fine(self) -> bool:
        """Whether the fine part of the offset alone is corrected."""
        return self.kept == FINE_OFFSET

    @property
    def pattern_deviations(self) -> tuple[float, float]:
        """Standard deviations of the offset, and of what is left of it; NaN where that is not known."""
        good = ~self.bad_pixels
        if not good.any():
            return 0.0, np.nan
        left = np.nan if self.offset_deviation is None else np.sqrt(np.mean(self.offset_deviation[good] ** 2))
        return float(self.offset[good].std()), float(left)


@dataclass(frozen=True)
class _Samples:
    """Frames less their level, which of their samples count, and the pattern that the gradients of halves share."""

    frames: Array
    usable: Array
    halves: tuple[Array, Array]
    bad: Array
    level: float
    rounding: float

    @classmethod
    def of(cls, keyframes: Keyframes) -> _Samples:
        frames = keyframes.frames
        if len(frames) < MIN_FRAMES:
            raise DataError(
                f"{len(frames)} of {keyframes.length} frame(s) show anything new, too few. "
                "Record for some seconds while the camera moves"
            )
        usable = _unsaturated(frames)
        thin = np.s_[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE]
        level = float(np.median(frames[thin][usable[thin]])) if usable[thin].any() else 0.0
        frames = np.where(usable, frames, np.float32(level))
        frames -= np.float32(level)
        early, late = np.s_[: len(frames) // 2], np.s_[len(frames) // 2 :]
        halves = gradient_consensus(frames[early], usable[early]), gradient_consensus(frames[late], usable[late])
        rounding = rounding_deviation(keyframes.frames[0])
        few = np.s_[:: max(1, len(frames) // FRAMES)]
        some = frames[few] - (halves[0] + halves[1]) / 2
        around = of_neighbours(some)
        bad = defective_pixels(np.where(usable[few], some, around), around, rounding) | ~usable.any(0)
        return cls(frames, usable, halves, bad, level, rounding)

    @property
    def known(self) -> Array:
        """Samples that count, of pixels that seem to respond, (N, h, w) bool."""
        return self.usable & ~self.bad

    @property
    def pattern(self) -> Array:
        """Shared by all frames, (h, w)."""
        return (self.halves[0] + self.halves[1]) / 2

    @property
    def filled(self) -> Array:
        """The frames, float32, samples that do not count like their neighbours: a spike would spread when warped."""
        frames, known, (height, width) = self.frames.copy(), self.known, self.frames.shape[1:]
        k, y, x = np.nonzero(~known)
        total, weight = np.zeros(len(k)), np.full(len(k), np.finfo(float).tiny)
        for i, j in itertools.product((-1, 0, 1), repeat=2):
            near = k, np.clip(y + i, 0, height - 1), np.clip(x + j, 0, width - 1)
            total += known[near] * self.frames[near]
            weight += known[near]
        frames[k, y, x] = total / weight
        return frames


def estimate_sensor(
    keyframes: Keyframes, *, former: CorrectionMaps | None = None, jumps: Sequence[int] = ()
) -> SensorEstimate:
    """Estimate gain, offset and bad pixels.

    Args:
        keyframes: of a recording.
        former: of the same sensor; the low-order part of their offset stays where the frames do not tell it.
        jumps: numbers of frames at which the pattern may jump.

    Raises:
        DataError: There are few frames, or the camera stands still.
    """
    samples = _Samples.of(keyframes)
    found = _of_registered(samples, keyframes, former, jumps)
    if found is not None:
        return found
    _demand_motion(samples.frames, samples.pattern, _neighbouring(keyframes))
    return replace(_of_displaced(samples, keyframes, former), jumps=tuple(jumps))


def estimate_fine_offset(keyframes: Keyframes) -> SensorEstimate:
    """The fine offset and bad pixels alone: at once, from few frames.

    Raises:
        DataError: As `estimate_sensor`.
    """
    samples = _Samples.of(keyframes)
    _demand_motion(samples.frames, samples.pattern, _neighbouring(keyframes))
    return _estimate(samples, SensorSolution.of_offset(fine_part(*samples.halves)), FINE_OFFSET)


def _of_registered(
    samples: _Samples, keyframes: Keyframes, former: CorrectionMaps | None, jumps: Sequence[int]
) -> SensorEstimate | None:
    """The sensor by frames that register; None where too few do, or do not fit."""
    frames, usable, size = samples.filled, samples.known, samples.frames.shape[1:]
    detail = np.array(parallel_map(_finest_detail, list(frames)))
    contrasts = np.where(detail > 0, detail / (np.median(detail) or 1.0), 1.0)
    factor = coarsening(size)
    small, known = _averaged(frames, usable, factor)
    start = _averaged(samples.pattern[None], ~samples.bad[None], factor)[0][0]
    best = _solved(find_burst(small, known, len(frames) // 2, start, contrasts))
    if best is None or not _holds(*best, small.mean(0)):
        turns = best is not None and best[1].registers
        best = _solved(short_bursts(small, known, keyframes.stretches, start, contrasts))
        if best is None or not best[1].is_determined:
            return _fine_offset(samples, fine_part(*samples.halves), former) if turns else None
    found, solution = best
    numbers, bursts = found.numbers, found.bursts
    if solution.motion_error > MOTION_ERRORS[-1]:  # one who walks by may pass for the scene, that for the pattern
        references = [(own, own[burst.reference]) for burst, own in zip(bursts, found.frames, strict=True)]
        even = small / contrasts.astype(np.float32)[:, None, None]
        _demand_motion(even, solution.offset, [(k, one) for own, one in references for k in own if k != one])
    uncertainty = solution.uncertainty
    moving = [burst.moving_share(np.subtract(*burst.compared(solution.offset, solution.gain))) for burst in bursts]
    if factor > 1:
        bursts = [burst.enlarged(frames[k], usable[k], factor) for burst, k in zip(bursts, found.frames, strict=True)]
        mean, variance = (enlarged(each, size, factor) for each in solution.low_order)
        solution = solve_sensor(bursts, (mean, variance))
    expected = np.concatenate([burst.compared(solution.offset, solution.gain)[1] for burst in bursts])
    for burst, k in zip(bursts, found.frames, strict=True):
        burst.frames = samples.frames[k]  # with what bad pixels show
    shown = np.concatenate([burst.corrected(solution.offset, solution.gain) for burst in bursts])
    shown = np.where(samples.usable[numbers], shown, expected)
    places, gains = keyframes.numbers[numbers], np.concatenate([burst.gains for burst in bursts])
    return _estimate(
        samples,
        solution,
        "gain and offset",
        (shown, expected),
        messages=tuple(
            _messages(np.any([burst.tells for burst in bursts], axis=0), float(np.mean(moving)), uncertainty)
        ),
        contrasts=(places, gains) if found.bursts[0].frame_prior.gain_variance else None,
        jumps=tuple(each for each in jumps if _may_jump(shown - expected, places < each, solution.noise)),
    )


def _finest_detail(frame: Array) -> float:
    """Mean size of the finest detail of a frame (h, w), edges clipped: it is mostly the sensor's."""
    size = np.abs(np.diff(np.diff(frame, axis=0), axis=1))
    return float(np.minimum(size, 2 * size.mean()).mean())


def _solved(found: Bursts | None) -> tuple[Bursts, SensorSolution] | None:
    return None if found is None else (found, solve_sensor(found.bursts))


def _holds(found: Bursts, solution: SensorSolution, mean: Array) -> bool:
    """Whether frames register as a whole, or nearly so, of a camera that turns about one axis."""
    one_way = _one_way(found.bursts[0].tells) is not None
    fit = solution.inflation <= MAX_INFLATION or (one_way and solution.registers)
    # The mean varies less over long periods than the scenes would that another offset leaves.
    left, before = (float(low_order_part(each).std()) for each in (mean - solution.offset, mean))
    return fit and left <= MAX_CANCELLATION * before


def _one_way(tells: Array) -> tuple[str, str, str] | None:
    """How a camera moves along one axis alone, by the modes (h, w) that its motion tells."""
    along = (tells[1:, 0], tells[0, 1:])
    return next((words for told, words in zip(along, ONE_WAY, strict=True) if told.mean() < 0.5), None)


def _of_displaced(samples: _Samples, keyframes: Keyframes, former: CorrectionMaps | None) -> SensorEstimate:
    """The sensor of a camera that moves among near things."""
    size = samples.frames.shape[1:]
    factor = coarsening(size)
    small, _ = _averaged(samples.frames, samples.known, factor)
    offset = fine_part(*samples.halves)
    whole = (offset + low_order_part(samples.pattern))[None].astype(np.float32)
    start = _averaged(whole, ~samples.bad[None], factor)[0][0]
    low = solve_low_order(small, keyframes.neighbours, start)
    if low is None:
        return _fine_offset(samples, offset, former)
    return _estimate(samples, SensorSolution.of_offset(offset + enlarged(low, size, factor)), "offset")


def _fine_offset(samples: _Samples, offset: Array, former: CorrectionMaps | None) -> SensorEstimate:
    """The fine part (h, w), of a pattern whose shading the frames do not tell: that of former maps stays."""
    if former is not None:
        offset = offset + low_order_part(former.offset + (former.gain - 1) * samples.level)
        return _estimate(samples, SensorSolution.of_offset(offset), "offset")
    message = Message(
        "shading-stays",
        "the shading of the fixed pattern could not be separated from the scenes and was not corrected: it is "
        "weak, or the camera moves too little",
    )
    return _estimate(samples, SensorSolution.of_offset(offset), FINE_OFFSET, messages=(message,))


def _estimate(
    samples: _Samples, solution: SensorSolution, kept: str, registered: tuple[Array, Array] | None = None, **more: Any
) -> SensorEstimate:
    """The estimate, its bad pixels judged again by `registered` frames and what they should show, if there are any."""
    gain, offset, bad = solution.gain, solution.offset, samples.bad
    if registered is not None:
        frames, expected = registered
        again = defective_pixels(frames, expected, samples.rounding) | ~samples.usable.any(0)
        # The samples of pixels that were left out tell their offset now.
        offset = np.where(bad & ~again, offset + np.median(frames - expected, axis=0), offset)
        bad = again
    offset = offset - (0.0 if bad.all() else offset[~bad].mean())
    noise = solution.noise if np.isfinite(solution.noise) else noise_deviation(samples.frames - offset)
    return SensorEstimate(
        np.where(bad, 1, gain),
        offset,
        bad,
        samples.level,
        solution.deviation,
        kept,
        solution.motion_error,
        noise=max(noise, samples.rounding),
        **more,
    )


def _averaged(frames: Array, usable: Array, factor: int) -> tuple[Array, Array]:
    """Means of frames over blocks, float32, and where all samples of a block count."""
    if factor == 1:
        return frames, usable
    means = block_means(frames, usable, factor).astype(np.float32)
    return means, block_sums(usable, factor) > factor**2 / 2


def _may_jump(rest: Array, before: Array, noise: float) -> bool:
    """Whether residuals (n, h, w) of registered frames allow another pattern before; True where none tell."""
    counts = before.sum(), (~before).sum()
    if not all(counts):
        return True
    change = rest[before].mean(0) - rest[~before].mean(0)
    expected = noise**2 * (1 / counts[0] + 1 / counts[1])
    return bool(np.median(change**2) / CHI_SQUARED_MEDIAN > MAX_CHANGE * expected)


def _messages(tells: Array, moving: float, uncertainty: float) -> Iterator[str]:
    """What is said of an uncertain low-order part, of modes (h, w) that are open, and of what moves."""
    if UNCERTAIN < uncertainty < np.inf:
        yield Message(
            "motion-small",
            "the camera moves by little, so that the shading of the fixed pattern and the scene are hardly told apart: "
            "some of the scene may be in the correction. Move the camera farther, up and down and sideways",
        )
    if words := _one_way(tells):
        motion, where, remedy = words
        yield Message(
            "camera-turns-one-way",
            f"the camera {motion}: the shading of the fixed pattern {where} is not separated from the scenes', "
            f"and was left as it was. {remedy}",
        )
    if moving > MIN_MOVING:
        yield Message(
            "moving-object",
            f"something moves by itself, as a person or a car does: {moving:.1%} of the values show it. It is kept, "
            "and the correction hardly uses it",
        )


def _unsaturated(frames: Array) -> Array:
    """Samples (N, h, w) between the values at which some are saturated."""
    some = frames[:: max(1, len(frames) // FRAMES)]
    ends = saturated_samples(some)
    if ends is None:
        return np.isfinite(frames)
    low, high = some[ends < 0].max(initial=-np.inf), some[ends > 0].min(initial=np.inf)
    return np.asarray((frames > low) & (frames < high))


def _neighbouring(keyframes: Keyframes) -> list[tuple[int, int]]:
    """Pairs of keyframes that may show the same things, about as many as there are keyframes."""
    count = len(keyframes.frames)
    pairs = [(k, other) for k, others in enumerate(keyframes.neighbours) for other in others if other > k]
    return spread(pairs or [(k, k + 1) for k in range(count - 1)], count)


def _demand_motion(frames: Array, pattern: Array, pairs: Sequence[tuple[int, int]]) -> None:
    """Raise `CameraAtRestError` if most pairs of frames (N, h, w) differ by little but noise and level."""
    if np.median(changes(frames, pairs, pattern)) < MIN_CHANGE_SIGMAS:
        raise CameraAtRestError(AT_REST)
