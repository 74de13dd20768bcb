"""Gain, offset and bad pixels of a camera from the keyframes of a recording.

Fine offsets come from the gradients that all frames share, slow ones from what the brightness of a moving scene changes
along its way, gains from registered frames. The result is compared with less of it on frames that were held out: what
does not help them is left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch

from deepir.arrays.noise_level import ROUNDING_SIGMA, quantisation_step
from deepir.calibration import CorrectionMaps
from deepir.errors import ConfigError, DataError, nearest
from deepir.io.inspection.saturated_samples import saturated_samples
from deepir.messages import Message
from deepir.multiview.camera_at_rest import is_at_rest
from deepir.multiview.low_order_part import slow_part
from deepir.multiview.texture_flow import Displacement, motion_extent
from deepir.recording.automatic_gain import PatternStrength, pattern_strengths
from deepir.recording.consensus import gradient_consensus
from deepir.recording.defective_pixels import defective_pixels
from deepir.recording.held_out import HeldOutFrames
from deepir.recording.keyframes import Keyframes, spread
from deepir.recording.offset import fine_offset, separate_offset
from deepir.recording.parallax import parallax_ratio
from deepir.recording.pattern_shares import scale_parts, shrink_offset
from deepir.recording.responses import noise_deviation, refine_responses

Array = np.ndarray[Any, Any]

MAX_PAIRS = 90  # pairs of frames whose displacements are sought
MIN_KEYFRAMES = 4
#: What a correction may consist of, from nothing to all; and the word for the choice by held-out frames.
CORRECTIONS = ("none", "fine_offset", "offset", "registered_offset", "gain_and_offset")
AUTO = "auto"
LEAST_NATS = 30.0  # by which a larger correction makes held-out frames likelier, to be chosen
SAMPLE_STRIDE = 4  # px, between samples that a median is taken of
FRAMES_OF_LIMITS = 12  # keyframes whose values show where samples are saturated
#: Upper quartile of the changes between neighbouring keyframes, in sigmas of the noise of a change, below which nothing
#: has moved.
LEAST_CHANGE = 2.2
#: Motion of a camera at rest, px, at most, and share of the frame whose displacement is known then, at least. Before
#: tripods it was 0.3 to 1.2 px and 75 %.
REST_MOTION, REST_KNOWN = 1.5, 0.5
AT_REST = (
    "the camera stands still in most of the recording, or sees nothing but a uniform wall, so that scene and fixed "
    "pattern cannot be separated. Move the camera over something with edges, or apply maps of another recording: "
    "deepir apply MAPS FILE"
)
#: Of a camera whose scenes do not move along this axis.
ONE_WAY = (
    Message(
        "shading-down-not-separated",
        "the camera turns sideways only: the shading of the fixed pattern from top to bottom is not separated from the "
        "scenes', and was left as it is. Tilt the camera too",
    ),
    Message(
        "shading-across-not-separated",
        "the camera tilts only: the shading of the fixed pattern from left to right is not separated from the scenes', "
        "and was left as it is. Turn the camera sideways too",
    ),
)
FOLDS = 4  # parts of the groups of frames; each part is held out once
FRAMES_AT_REST = 16  # keyframes that are compared whether the camera rests
#: Gains outside these limits are of pixels that do not respond to the scene.
GAIN_LIMITS = (0.5, 2.0)


class CameraAtRestError(DataError):
    """The camera stands still."""


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
        shares: of the offset's columns, rows, pixels and blobs that other frames hold; empty where it was not judged.
        messages: for the user.
        parallax: ratio, see `parallax_ratio`; NaN where it was not judged.
    """

    gain: Array
    offset: Array
    bad_pixels: Array
    level: float
    strength: PatternStrength | None
    kept: str
    nats: dict[str, float]
    shares: dict[str, float] = field(default_factory=dict)
    messages: tuple[str, ...] = ()
    parallax: float = np.nan


def estimate_sensor(
    keyframes: Keyframes, correction: str = AUTO, *, former: CorrectionMaps | None = None, shrink: bool = True
) -> SensorEstimate:
    """Estimate gain, offset and bad pixels.

    Args:
        keyframes: of a recording.
        correction: one of `CORRECTIONS`; "auto": the one that serves held-out frames best.
        former: of the same sensor; held-out frames choose between the slow part of their offset and the new one.
        shrink: whether the parts of the offset are scaled by the shares of them that held-out frames hold.

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
    frames, usable, level, offset = _consensus(estimated, limits)
    gains = pattern_strengths(frames, usable, offset) if keyframes.eight_bits else None
    if gains is not None:
        frames = (frames - level) / gains[:, None, None] + np.float32(level)
        offset = gradient_consensus(frames, usable).astype(np.float32)
    bad = defective_pixels(frames, usable, offset, _rounding(estimated.frames))
    pairs = spread(estimated.pairs, MAX_PAIRS)
    separated = separate_offset(frames, usable, ~bad, offset, pairs, level)
    if _rests(separated.displacements, min(frames.shape[1:])):
        raise CameraAtRestError(AT_REST)
    offsets = {"fine": separated.fine}
    if separated.whole is not None:
        offsets["whole"] = separated.whole
    if former is not None and gains is None:
        rest = former.offset + (former.gain - 1) * level - separated.fine
        offsets["former"] = separated.fine + slow_part(rest, ~bad)
    held_out = _held_out_frames(held, _usable(held.frames, limits) & ~bad, list(offsets.values()))
    masked = np.where(usable, frames, np.nan).astype(np.float32)
    base, messages = _base(offsets, held_out, correction)
    if separated.axis_at_rest is not None and base[0] == "offset":
        messages.append(ONE_WAY[separated.axis_at_rest])
    candidates = _candidates(masked, base, separated.displacements, level, with_gain=gains is None)
    bad |= _unresponsive(candidates["gain_and_offset"][0]) if "gain_and_offset" in candidates else False
    nats = {name: found for name, each in candidates.items() if np.isfinite(found := held_out.nats(*each))}
    kept = correction
    if correction == AUTO:
        kept = _choice(nats)
        if kept == "none":
            messages.append(
                Message(
                    "no-correction-helps",
                    "no correction makes held-out frames better: the recording is left as it is",
                )
            )
    elif correction not in candidates:
        raise DataError(
            f"the correction '{correction}' cannot be estimated from this recording; {'; '.join(messages)}"
        )
    gain, offset = candidates[kept]
    gain, offset = np.where(bad, 1, gain), offset - offset[~bad].mean()
    strength = None if gains is None else PatternStrength.of_frames(offset, estimated.frames, usable)
    shares: dict[str, float] = {}
    if shrink and kept != "none":
        offset, shares = (
            _shrunk(gain, offset, ~bad, level, held.frames, _usable(held.frames, limits), strength)
            if len(held.frames)
            else _shrunk_by_others(offset, frames, usable, ~bad, estimated.groups)
        )
    parallax = parallax_ratio(frames, usable & ~bad, gain, offset, separated.displacements)
    return SensorEstimate(gain, offset, bad, level, strength, kept, nats, shares, tuple(messages), parallax)


def estimate_fine_offset(keyframes: Keyframes) -> SensorEstimate:
    """The fine offset and bad pixels alone: at once, from few frames, without displacements.

    Raises:
        DataError: As `estimate_sensor`.
    """
    frames, usable, level, consensus = _consensus(keyframes, _limits(keyframes.frames))
    bad = defective_pixels(frames, usable, consensus, _rounding(keyframes.frames))
    offset = fine_offset(consensus, ~bad)
    offset, shares = _shrunk_by_others(offset - offset[~bad].mean(), frames, usable, ~bad, keyframes.groups)
    return SensorEstimate(np.ones_like(offset), offset, bad, level, None, "fine_offset", {}, shares)


def _shrunk(
    gain: Array,
    offset: Array,
    known: Array,
    level: float,
    held: Array,
    usable: Array,
    strength: PatternStrength | None,
) -> tuple[Array, dict[str, float]]:
    """An offset (h, w), its parts scaled by the shares of them that held-out frames (N, h, w) have."""
    frames = np.where(usable, held, np.nan)
    if strength is not None:
        frames = frames / np.array([strength(each) for each in frames], np.float32)[:, None, None]
    scaled, shares = shrink_offset(offset / gain, known, (frames - level) / gain)
    return gain * scaled, shares


def _shrunk_by_others(
    offset: Array, frames: Array, usable: Array, known: Array, groups: Array
) -> tuple[Array, dict[str, float]]:
    """A fine offset (h, w), scaled by the mean shares that some groups of frames hold of what the others give."""
    found = []
    for fold in np.unique(groups % FOLDS):
        here = groups % FOLDS == fold
        if here.all():
            return offset, {}
        others = fine_offset(gradient_consensus(frames[~here], usable[~here]), known)
        seen = np.where(usable[here], frames[here], np.nan)
        found.append(shrink_offset(others, known, seen)[1])
    shares = {name: float(np.mean([each[name] for each in found])) for name in found[0]}
    return scale_parts(offset, known, shares), shares


def _consensus(keyframes: Keyframes, limits: tuple[float, float]) -> tuple[Array, Array, float, Array]:
    """Frames with their level in place of unusable samples, which are usable, the level, and the shared offset."""
    frames, usable = keyframes.frames, _usable(keyframes.frames, limits)
    if len(frames) < MIN_KEYFRAMES:
        raise DataError(
            f"{len(frames)} of {keyframes.length} frame(s) show anything new, too few. "
            "Record for some seconds while the camera moves"
        )
    level = _median(frames, usable)
    frames = np.where(usable, frames, np.float32(level))
    offset = gradient_consensus(frames, usable).astype(np.float32)
    _demand_motion(frames, offset, keyframes.pairs)
    return frames, usable, level, offset


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


def _rounding(frames: Array) -> float:
    """Standard deviation of the rounding error of samples (N, h, w)."""
    some = torch.from_numpy(frames[:: max(1, len(frames) // FRAMES_OF_LIMITS)])[:, None]
    return ROUNDING_SIGMA * quantisation_step(some, some.isfinite())


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
        raise CameraAtRestError(AT_REST)


def _rests(found: Sequence[Displacement], short_side: int) -> bool:
    """Whether most of the scene is seen to stay where it is, as before a camera at rest whose gain changes."""
    if np.mean([each.known.mean() for each in found] or [0.0]) < REST_KNOWN:
        return False
    return max(motion_extent(found)) * (short_side // min(found[0].known.shape)) < REST_MOTION


def _held_out_frames(held: Keyframes, usable: Array, offsets: Sequence[Array]) -> HeldOutFrames:
    """Frames that judge; the displacements of their scenes are sought with each offset."""
    level = _median(held.frames, usable) if usable.any() else 0.0
    return HeldOutFrames(held, usable, level, [(np.ones_like(each), each) for each in offsets])


def _base(
    offsets: dict[str, Array], held_out: HeldOutFrames, correction: str
) -> tuple[tuple[str, Array], list[str]]:
    """The offset with or without what is slow, new or former, named as in `CORRECTIONS`; and messages."""
    if correction == "fine_offset":
        return (correction, offsets["fine"]), []
    whole = offsets.get("whole")
    if correction == "offset" and whole is not None:
        return (correction, whole), []
    left = {name: _slow_nats(held_out, each) for name, each in offsets.items()}
    better = [
        name for name in offsets if left["fine"] - left[name] > (LEAST_NATS if name == "whole" else 0.0)
    ]
    if better:
        return ("offset", offsets[min(better, key=left.__getitem__)]), []
    return ("fine_offset", offsets["fine"]), [
        Message(
            "slow-part-not-separated",
            "what is slow of the fixed pattern is not separated from the scenes', and was left as it is: it is weak, "
            "or the camera moves too little",
        )
    ]


def _candidates(
    masked: Array, base: tuple[str, Array], found: Sequence[Displacement], level: float, *, with_gain: bool
) -> dict[str, tuple[Array, Array]]:
    """Corrections (gain, offset), each of more than the one before."""
    name, offset = base
    one = np.ones_like(offset)
    gain, registered = refine_responses(masked, found, one, offset, level, with_gain=with_gain)
    candidates = {
        "none": (one, np.zeros_like(one)),
        name: (one, offset),
        "registered_offset": (one, registered),
    }
    return candidates | ({"gain_and_offset": (gain, registered)} if with_gain else {})


def _slow_nats(held_out: HeldOutFrames, offset: Array) -> float:
    """Of the changes of brightness along displacements, which the fine pattern has no part in; NaN: not judged."""
    left = held_out.left(np.ones_like(offset), offset)
    return np.nan if left is None else left.nats


def _unresponsive(gain: Array) -> Array:
    return np.asarray((gain < GAIN_LIMITS[0]) | (gain > GAIN_LIMITS[1]))
