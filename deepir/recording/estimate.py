"""Gain, offset and bad pixels of a camera from the keyframes of a recording.

The fine offset comes from the gradients that all frames share, its low-order part from changes of brightness along the
scene's displacements, the gain from registered frames. Corrections with fewer of these parts compete on held-out
frames: a part that does not help there is left out.
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
from deepir.multiview.low_order_part import low_order_part
from deepir.multiview.texture_flow import Displacement, motion_extent
from deepir.recording.automatic_gain import PatternStrength, pattern_strengths
from deepir.recording.candidates import candidate_corrections, choose_correction, choose_offset, turns_one_way
from deepir.recording.consensus import gradient_consensus
from deepir.recording.defective_pixels import defective_pixels
from deepir.recording.held_out import HeldOutFrames
from deepir.recording.keyframes import Keyframes, spread
from deepir.recording.offset import fine_offset, separate_offset
from deepir.recording.parallax import parallax_ratio
from deepir.recording.pattern_shares import scale_parts, shrink_offset
from deepir.recording.responses import noise_deviation

Array = np.ndarray[Any, Any]

MAX_PAIRS = 90  # pairs of frames whose displacements are sought
MIN_KEYFRAMES = 4
#: What a correction may consist of, from nothing to all; and the word for the choice by held-out frames.
CORRECTIONS = ("none", "fine_offset", "offset", "registered_offset", "gain_and_offset")
AUTO = "auto"
SAMPLE_STRIDE = 4  # px, between samples that a median is taken of
FRAMES_OF_LIMITS = 12  # keyframes whose values show where samples are saturated
#: Upper quartile of the changes between neighbouring keyframes, in sigmas of the noise of a change, below which nothing
#: has moved.
MIN_CHANGE_SIGMAS = 2.2
#: Motion of a camera at rest, px, at most, and share of the frame whose displacement is known then, at least. Before
#: tripods it was 0.3 to 1.2 px and 75 %.
MAX_REST_MOTION, MIN_REST_KNOWN = 1.5, 0.5
AT_REST = (
    "the camera stands still in most of the recording, or sees nothing but a uniform wall, so that scene and fixed "
    "pattern cannot be separated. Move the camera over something with edges, or apply maps of another recording: "
    "deepir apply MAPS FILE"
)
FOLDS = 4  # parts of the groups of frames; each part is held out once
FRAMES_AT_REST = 16  # keyframes that are compared whether the camera rests
#: Gains outside these limits are of pixels that do not respond to the scene.
GAIN_LIMITS = (0.5, 2.0)


class CameraAtRestError(DataError):
    """The camera stands still."""


@dataclass(frozen=True)
class SensorEstimate:
    """Estimate of the sensor of a recording: `frame = level + offset + gain (scene - level)`.

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
        former: of the same sensor; held-out frames choose between the low-order part of their offset and the new one.
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
        offsets["former"] = separated.fine + low_order_part(rest, ~bad)
    held_out = _held_out_frames(held, _usable(held.frames, limits) & ~bad, list(offsets.values()))
    masked = np.where(usable, frames, np.nan).astype(np.float32)
    base, messages = choose_offset(offsets, held_out, correction)
    if separated.axis_at_rest is not None and base[0] == "offset":
        messages.append(turns_one_way(separated.axis_at_rest))
    candidates = candidate_corrections(masked, base, separated.displacements, level, with_gain=gains is None)
    bad |= _unresponsive(candidates["gain_and_offset"][0]) if "gain_and_offset" in candidates else False
    nats = {name: found for name, each in candidates.items() if np.isfinite(found := held_out.nats(*each))}
    kept = correction
    if correction == AUTO:
        kept = choose_correction(nats)
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
        or np.median(changes) < MIN_CHANGE_SIGMAS * noise
        or is_at_rest(some, np.ones(some.shape, bool))
    ):
        raise CameraAtRestError(AT_REST)


def _rests(found: Sequence[Displacement], short_side: int) -> bool:
    """Whether most of the scene is seen to stay where it is, as before a camera at rest whose gain changes."""
    if np.mean([each.known.mean() for each in found] or [0.0]) < MIN_REST_KNOWN:
        return False
    return max(motion_extent(found)) * (short_side // min(found[0].known.shape)) < MAX_REST_MOTION


def _held_out_frames(held: Keyframes, usable: Array, offsets: Sequence[Array]) -> HeldOutFrames:
    """Frames that judge; the displacements of their scenes are sought with each offset."""
    level = _median(held.frames, usable) if usable.any() else 0.0
    return HeldOutFrames(held, usable, level, [(np.ones_like(each), each) for each in offsets])


def _unresponsive(gain: Array) -> Array:
    return np.asarray((gain < GAIN_LIMITS[0]) | (gain > GAIN_LIMITS[1]))
