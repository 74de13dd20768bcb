"""A correction that leaves more fixed pattern than a simpler one is given up for it.

From the most to the least that is estimated: gain and offset as they were found; the same without what is slow of
them; the offset of an estimate that registers no frames; no correction. Each is judged by frames of the same recording
that the estimate did not use, where there are any, else by the burst's own.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from deepir.average import filled
from deepir.burst import Burst
from deepir.closed_form.unregistered import estimate_offset
from deepir.errors import DataError
from deepir.evidence.slow import polynomials
from deepir.result import Result, neutral
from deepir.validation.held_out_pattern import Judge, Left

Array = np.ndarray[Any, Any]

#: Nats by which a simpler correction has to be likelier than the one that was found, for that to be given up.
MARGIN = 10.0
#: Pairs of the burst's own frames that are compared, and frames apart.
OWN_PAIRS, GAPS = 4, (1, 2)
#: Frames below which no pattern is estimated without registration.
MINIMUM_FRAMES = 4


@dataclass(frozen=True)
class Correction:
    """Gain and offset (h, w), what they are called, and what they leave."""

    name: str
    gain: Array
    offset: Array
    left: Left


def safeguarded(result: Result, burst: Burst) -> Result:
    """The result, or one with a simpler correction that leaves clearly less pattern; a message says so."""
    judge = _judge(burst, [(result.gain, result.offset)], result.level)

    def judged(name: str, gain: Array, offset: Array) -> Correction | None:
        left = judge.left(gain, offset)
        return None if left is None else Correction(name, gain, offset, left)

    found = judged("gain and offset as estimated", result.gain, result.offset)
    raw = judged("no correction", np.ones(burst.size), np.zeros(burst.size))
    if found is None or raw is None:
        return result
    flat = judged("gain and offset without their slow parts", result.gain, _without_slow_part(result, burst))
    best = min(found, flat or raw, raw, key=_nats)
    quick = judged("", raw.gain, judge.shared)
    if len(burst.frames) >= MINIMUM_FRAMES and quick and quick.left.nats < best.left.nats:
        offset, _ = estimate_offset(burst.frames, burst.valid & ~burst.bad_pixels)
        free = judged("an offset that is estimated without registration, and no gain", raw.gain, offset)
        best = min(best, free or best, key=_nats)
    if best.left.nats > found.left.nats - MARGIN:
        best = found
    result.metrics["fixed_pattern_left"] = {"raw": raw.left.change, "corrected": best.left.change}
    if best is found:
        return result
    message = (
        f"gain and offset as estimated leave a fixed pattern of {found.left.change:.3g} in "
        f"{'frames beside the burst' if burst.beside is not None else 'the frames'}, {best.name} "
        f"{best.left.change:.3g}, uncorrected frames {raw.left.change:.3g}: the result has {best.name}"
    )
    return _replaced(result, burst, best, message)


def unregistered(burst: Burst, refusal: DataError) -> Result:
    """A result for frames that do not register, but show the same things displaced; else `refusal` is raised again."""
    usable = burst.valid & ~burst.bad_pixels
    if len(burst.frames) < MINIMUM_FRAMES or not usable.any():
        raise refusal
    offset, related = estimate_offset(burst.frames, usable)
    if not related:
        raise refusal
    gain = np.ones(burst.size)
    judge = _judge(burst, [(gain, offset)], np.zeros(len(burst.frames)))
    left, raw = judge.left(gain, offset), judge.left(gain, np.zeros(burst.size))
    if left is None or raw is None:
        raise refusal
    name = "an offset that is estimated without registration, and no gain"
    if left.nats > raw.nats:
        name, offset, left = "no correction", np.zeros(burst.size), raw
    result = neutral(burst.frames[0], len(burst.frames), burst.size, burst.bad_pixels)
    result.metrics = {
        "iterations": 0,
        "evaluations": 0,
        "stop_reason": "the frames do not register as a whole",
        "fixed_pattern_left": {"raw": raw.change, "corrected": left.change},
    }
    message = (
        f"the frames do not register as a whole, but their parts move: the result has {name}. It leaves a fixed "
        f"pattern of {left.change:.3g}, uncorrected frames {raw.change:.3g}"
    )
    return _replaced(result, burst, Correction(name, gain, offset, left), message)


def _nats(correction: Correction) -> float:
    return correction.left.nats


def _judge(burst: Burst, corrections: list[tuple[Array, Array]], level: Array) -> Judge:
    """Compares corrections by the frames beside the burst, or else by its own less their `level`, (N,)."""
    if burst.beside is not None:
        finite = np.isfinite(burst.beside)
        pairs = [(k, k + 1) for k in range(0, len(burst.beside), 2)]
        return Judge(np.where(finite, burst.beside, 0), finite & ~burst.bad_pixels, pairs, corrections)
    count = len(burst.frames)
    pairs = [(k, k + gap) for gap in GAPS for k in range(count - gap)]
    pairs = pairs[:: max(1, -(-len(pairs) // OWN_PAIRS))]
    frames = burst.frames - np.nan_to_num(level).astype(np.float32)[:, None, None]
    return Judge(frames, burst.valid & ~burst.bad_pixels, pairs, corrections)


def _without_slow_part(result: Result, burst: Burst) -> Array:
    """The offset with which the pattern at the frames' level has nothing slow."""
    level = float(np.median(burst.frames[burst.valid]))
    pattern = torch.from_numpy(result.offset + (result.gain - 1) * level).double()
    slow = polynomials(*burst.size, torch.device("cpu")).nearest(pattern).numpy()
    return np.asarray(result.offset - slow + slow.mean())


def _replaced(result: Result, burst: Burst, correction: Correction, message: str) -> Result:
    """The result with another correction; its scene is the corrected first frame, or of each frame its own."""
    good = torch.from_numpy(burst.valid & ~burst.bad_pixels)[:, None]
    corrected = torch.from_numpy((burst.frames - correction.offset) / correction.gain)[:, None]
    own = result.scene.ndim == 3
    frames = corrected if own else corrected[:1]
    scene = torch.cat([filled(each[None], ok[None]) for each, ok in zip(frames, good, strict=False)])[:, 0]
    new = neutral((scene if own else scene[0]).numpy(), len(burst.frames), burst.size, burst.bad_pixels)
    if not own:
        new.frames_used[1:], new.motion[1:] = False, np.nan
    return dataclasses.replace(
        new,
        gain=correction.gain.astype(np.float32),
        offset=correction.offset.astype(np.float32),
        metrics=result.metrics,
        history=result.history,
        messages=[message, *result.messages],
    )
