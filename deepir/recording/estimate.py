"""Gain, offset and bad pixels of a camera from the keyframes of a recording.

Fine offsets come from the gradients that all frames share, slow ones from what the brightness of a moving scene changes
along its way, gains from registered frames. The result is compared with less of it on frames that were held out: what
does not help them is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.errors import ConfigError, DataError, nearest
from deepir.io.inspection.saturated_samples import saturated_samples
from deepir.multiview.camera_at_rest import is_at_rest
from deepir.multiview.held_out_pattern import Judge
from deepir.multiview.low_order_part import SLOW_SIGMA, slow_part
from deepir.multiview.low_order_pattern import coarsening, slow_pattern
from deepir.multiview.texture_flow import Displacement
from deepir.recording.automatic_gain import PatternStrength, pattern_strengths
from deepir.recording.consensus import gradient_consensus
from deepir.recording.defective_pixels import defective_pixels
from deepir.recording.keyframes import Keyframes
from deepir.recording.responses import noise_deviation, refine_responses

Array = np.ndarray[Any, Any]

MAX_PAIRS = 90  # pairs of frames whose displacements are sought
MAX_HELD_OUT_PAIRS = 8
#: px of the averaged frames; Gaussian over which changes of brightness are averaged: many pairs allow more than few.
CHANGE_SIGMA = 2.0
#: Ratio of the slow part of the pattern to that of the scenes' mean, from which it is the sensor's. Errors of the
#: displacements leave a part of the scenes' mean in the pattern: 0.2 to 0.9 of it in simulated drives.
LEAST_SLOW_RATIO = 1.5
#: px of the frames that the scene moves down, at most, and across, at least, where the camera turns only sideways; or
#: the other way round. Of the upper quartiles of the displacements in a pair of frames, those of nine pairs in ten.
LINE_MOTION, CROSS_MOTION = 2.0, 5.0
#: Deviation of the pattern's lines that have not moved, relative to the scene's that have: they are the sensor's from.
LEAST_LINE_RATIO = 1.2
COLUMN_SIGMA = 16.0  # px; of the Gaussian below which the columns' means are the scene's
MIN_KEYFRAMES = 4
#: What a correction may consist of, from nothing to all; and the word for the choice by held-out frames.
CORRECTIONS = ("none", "fine_offset", "offset", "registered_offset", "gain_and_offset")
AUTO = "auto"
LEAST_NATS = 50.0  # by which a larger correction makes held-out frames likelier, to be chosen
SAMPLE_STRIDE = 4  # px, between samples that a median is taken of
FRAMES_OF_LIMITS = 12  # keyframes whose values show where samples are saturated
#: Upper quartile of the changes between neighbouring keyframes, in sigmas of the noise of a change, below which nothing
#: has moved.
LEAST_CHANGE = 2.2
FRAMES_AT_REST = 16  # keyframes that are compared whether the camera rests
#: Gains outside these limits are of pixels that do not respond to the scene.
GAIN_LIMITS = (0.5, 2.0)


@dataclass(frozen=True)
class SensorEstimate:
    """What a recording tells of its sensor: `frame = level + offset + gain (scene - level)`.

    Attributes:
        gain: (h, w), around one.
        offset: (h, w), frames' units, mean zero.
        bad_pixels: (h, w) bool.
        level: frames' units, the median of the frames.
        strength: of the pattern in a frame, where an automatic gain control changes it; else None.
        kept: what the correction consists of, one of `CORRECTIONS`.
        nats: of each candidate on held-out frames, less is better; empty where it was not judged.
        messages: for the user.
    """

    gain: Array
    offset: Array
    bad_pixels: Array
    level: float
    strength: PatternStrength | None
    kept: str
    nats: dict[str, float]
    messages: tuple[str, ...]


def estimate_sensor(keyframes: Keyframes, correction: str = AUTO) -> SensorEstimate:
    """Estimate gain, offset and bad pixels.

    Args:
        keyframes: of a recording.
        correction: one of `CORRECTIONS`; "auto": the one that serves held-out frames best.

    Raises:
        ConfigError: There is no such correction.
        DataError: There are few frames, or the camera stands still, or `correction` cannot be estimated.
    """
    if correction not in (AUTO, *CORRECTIONS):
        raise ConfigError(
            f"correction '{correction}' is unknown; {nearest(correction, (AUTO, *CORRECTIONS))}"
        )
    estimated, held = keyframes.split()
    limits = _limits(keyframes.frames)
    frames, usable = estimated.frames, _usable(estimated.frames, limits)
    if len(frames) < MIN_KEYFRAMES:
        raise DataError(
            f"{len(keyframes.frames)} of {keyframes.length} frame(s) show anything new, too few. "
            "Record for some seconds while the camera moves"
        )
    level = _median(frames, usable)
    frames = np.where(usable, frames, np.float32(level))
    offset = gradient_consensus(frames, usable).astype(np.float32)
    _demand_motion(frames, offset, estimated.pairs)
    gains = pattern_strengths(frames, usable, offset) if keyframes.eight_bits else None
    if gains is not None:
        frames = (frames - level) / gains[:, None, None] + np.float32(level)
        offset = gradient_consensus(frames, usable).astype(np.float32)
    pairs = _spread(estimated.pairs, MAX_PAIRS)
    candidates, bad, messages = _candidates(frames, usable, pairs, offset, level, with_gain=gains is None)
    nats = _judged(held, limits, candidates, bad)
    kept = correction
    if correction == AUTO:
        kept = _choice(nats)
        if kept == "none":
            messages.append("no correction makes held-out frames better: the recording is left as it is")
    elif correction not in candidates:
        raise DataError(
            f"the correction '{correction}' cannot be estimated from this recording; {'; '.join(messages)}"
        )
    gain, offset = candidates[kept]
    offset = offset - offset[~bad].mean()
    strength = None if gains is None else PatternStrength.of_frames(offset, estimated.frames, usable)
    return SensorEstimate(np.where(bad, 1, gain), offset, bad, level, strength, kept, nats, tuple(messages))


def _choice(nats: dict[str, float]) -> str:
    """The simplest correction that no larger one beats clearly; the fine offset where frames do not tell."""
    kept = "none" if nats else "fine_offset"
    for name, each in nats.items():
        if each < nats[kept] - LEAST_NATS:
            kept = name
    return kept


def _limits(frames: Array) -> tuple[float, float]:
    """Values at or beyond which samples are saturated."""
    some = frames[:: max(1, len(frames) // FRAMES_OF_LIMITS)]
    ends = saturated_samples(some)
    if ends is None:
        return -np.inf, np.inf
    above, below = some[ends > 0], some[ends < 0]
    return below.max(initial=-np.inf), above.min(initial=np.inf)


def _usable(frames: Array, limits: tuple[float, float]) -> Array:
    return np.asarray((frames > limits[0]) & (frames < limits[1]))


def _median(frames: Array, usable: Array) -> float:
    """Of some of the usable samples."""
    return float(
        np.median(frames[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE][usable[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE]])
    )


def _demand_motion(frames: Array, offset: Array, pairs: Sequence[tuple[int, int]]) -> None:
    """Raise `DataError` if neighbouring frames differ only by noise, or all show the same scene."""
    noise = 2**0.5 * noise_deviation(frames - offset)
    changes = [float(np.quantile(np.abs(frames[i] - frames[j])[::3, ::3], 0.75)) for i, j in pairs]
    some = frames[:: max(1, len(frames) // FRAMES_AT_REST)]
    if (
        not changes
        or np.median(changes) < LEAST_CHANGE * noise
        or is_at_rest(some, np.ones(some.shape, bool))
    ):
        raise DataError(
            "the camera stands still in the whole recording, or sees nothing but a uniform wall, so that scene and "
            "fixed pattern cannot be separated. Move the camera over something with edges, or apply maps of another "
            "recording: deepir apply MAPS FILE"
        )


def _candidates(
    frames: Array,
    usable: Array,
    pairs: Sequence[tuple[int, int]],
    consensus: Array,
    level: float,
    *,
    with_gain: bool,
) -> tuple[dict[str, tuple[Array, Array]], Array, list[str]]:
    """Corrections (gain, offset) from none to all that registered frames tell; bad pixels; and messages."""
    one = np.ones_like(consensus)
    bad = defective_pixels(frames, usable, consensus)
    known = ~bad
    messages = []
    fine = consensus - slow_part(consensus - _columns(consensus, known), known)
    slow = slow_pattern(
        frames - consensus,
        usable & known,
        pairs,
        rounds=1,
        removed=consensus - fine,
        change_sigma=CHANGE_SIGMA,
    )
    offset = consensus + slow.offset
    scene = slow_part(np.mean(frames - offset, axis=0), known)[known].std()
    if not slow.related or slow_part(offset, known)[known].std() < LEAST_SLOW_RATIO * scene:
        offset = fine
        messages.append(
            "what is slow of the fixed pattern is not separated from the scenes', and was left as it is: it is weak, "
            "or the camera moves too little"
        )
    lines = _scene_lines(fine, frames - consensus, slow.displacements, coarsening(frames.shape[1:]))
    fine, offset = fine - lines, offset - lines
    masked = np.where(usable, frames, np.nan).astype(np.float32)
    gain, registered = refine_responses(masked, slow.displacements, one, offset, level, with_gain=with_gain)
    bad |= (gain < GAIN_LIMITS[0]) | (gain > GAIN_LIMITS[1])
    candidates = {"none": (one, np.zeros_like(consensus)), "fine_offset": (one, fine)}
    if not np.array_equal(offset, fine):
        candidates["offset"] = (one, offset)
    candidates["registered_offset"] = (one, registered)
    if with_gain:
        candidates["gain_and_offset"] = (gain, registered)
    return candidates, bad, messages


def _columns(pattern: Array, known: Array) -> Array:
    """The detail of the mean of each column, (1, w): mostly the sensor's. Of rows a scene has some, as a horizon."""
    counts = known.sum(0)
    profile = np.where(known, pattern, 0).sum(0) / np.maximum(counts, 1)
    return np.asarray(profile - ndimage.gaussian_filter1d(profile, COLUMN_SIGMA))[None]


def _scene_lines(fine: Array, corrected: Array, found: Sequence[Displacement], factor: int) -> Array:
    """What of rows or columns is the scene's, (h, w).

    A camera that only turns sideways sees a ledge at the same rows in all frames.
    """
    lines = np.zeros_like(fine)
    known = [each for each in found if each.known.any()]
    if not known:
        return lines
    start = np.indices(known[0].known.shape)
    far = [
        [float(np.quantile(np.abs(at - start[axis])[each.known], 0.75)) for each, at in moved]
        for axis, moved in enumerate(([(e, e.y) for e in known], [(e, e.x) for e in known]))
    ]
    down, across = (factor * float(np.quantile(each, 0.9)) for each in far)
    for axis, along, cross in ((1, down, across), (0, across, down)):
        if along >= LINE_MOTION or cross < CROSS_MOTION:
            continue
        profile = _detail(fine.mean(axis))
        scene = np.median([_detail(frame.mean(1 - axis)).std() for frame in corrected])
        if profile.std() < LEAST_LINE_RATIO * scene:
            lines = lines + np.expand_dims(profile, axis)
    return lines


def _detail(profile: Array) -> Array:
    return np.asarray(profile - ndimage.gaussian_filter1d(profile, SLOW_SIGMA))


def _judged(
    held: Keyframes,
    limits: tuple[float, float],
    candidates: dict[str, tuple[Array, Array]],
    bad: Array,
) -> dict[str, float]:
    """Nats of each candidate on held-out frames; empty where these do not tell."""
    if not held.pairs:
        return {}
    usable = _usable(held.frames, limits) & ~bad
    level = _median(held.frames, usable)
    frames = np.where(usable, held.frames, np.float32(level))
    # The judge divides by the gain about zero, the estimate about the level.
    maps = {name: (gain, offset + level * (1 - gain)) for name, (gain, offset) in candidates.items()}
    judge = Judge(
        frames,
        usable,
        _spread(held.pairs, MAX_HELD_OUT_PAIRS),
        [maps["fine_offset"], list(maps.values())[-1]],
    )
    left = {name: judge.left(*each) for name, each in maps.items()}
    return {
        name: each.nats + np.nan_to_num(each.detail_nats) for name, each in left.items() if each is not None
    }


def _spread(pairs: Sequence[tuple[int, int]], most: int) -> list[tuple[int, int]]:
    """At most so many of the pairs, evenly spread."""
    return [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, min(most, len(pairs))).astype(int))]
