"""A correction that leaves more fixed pattern than a simpler one is given up for it, part by part.

First the fine part of gain and offset, then their low-order part: as estimated, as an estimate without registration has
it, or none. Each is judged by frames of the same recording that the estimate did not use, where there are any, else by
the burst's own, which judge no fine part. A low-order part that no registration has found needs evidence: scenes share
low-order slopes (the sky is above), and an estimate takes these for the sensor's.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch

from deepir.arrays import Array
from deepir.arrays.windows import fill_nearest
from deepir.burst import Burst
from deepir.errors import DataError
from deepir.messages import Message
from deepir.multiview.held_out_pattern import CorrectionScorer, ResidualPattern
from deepir.multiview.low_order_pattern import is_implausible, low_order_part
from deepir.multiview.pattern import estimate_offset
from deepir.result import Result, neutral

#: Nats by which a simpler correction has to be likelier than the one that was found, for that to be given up.
MARGIN = 10.0
#: Standard errors over pairs of frames by which a low-order part without registration has to be likelier than none.
CERTAINTY = 3.0
#: Pairs of the burst's own frames that are compared, and frames apart.
OWN_PAIRS, GAPS = 4, (1, 2)
MIN_FRAMES = 4  # frames below which no pattern is estimated without registration
UNREGISTERED = "an offset that is estimated without registration, and no gain"
#: Messages on what only the estimate has that is given up.
OF_ESTIMATE = ("moving-object", "still-region", "pattern-cost")


@dataclass(frozen=True)
class Correction:
    """Gain and offset (h, w), what they are called, and what they leave."""

    name: str
    gain: Array
    offset: Array
    residual: ResidualPattern


def safeguarded(result: Result, burst: Burst, *, registered: bool, trusted: bool = True) -> Result:
    """The result, or one with a simpler correction that leaves less pattern; a message says so.

    It has to leave clearly less, or the result more than uncorrected frames. A low-order part stays without evidence
    only in a result of `registered` frames. A result that is not `trusted` gives way to the first frame as it is, where
    nothing else takes its place.
    """
    one, zero = np.ones(burst.size), np.zeros(burst.size)
    kept = result
    if not trusted:
        message = Message(
            "motion-not-trusted",
            "the motion is not to be trusted: the result has no correction, and is the first frame as it is",
        )
        kept = _replaced(result, burst, one, zero, message)
    scorer = _scorer(burst, [(result.gain, result.offset)], result.level)
    found = _candidates("gain and offset as estimated", scorer, burst, result.gain, result.offset)
    raw, shared = _candidates("no correction", scorer, burst, one, zero), scorer.score(one, scorer.shared)
    if found is None or raw is None or shared is None:
        return kept
    free = None
    # Half the fine pattern is left, or more of the low-order part than the median gradients leave.
    is_doubtful = found.fine.residual.detail > raw.fine.residual.detail / 2 or shared.nats < min(
        found.whole.residual.nats, found.fine.residual.nats
    )
    if registered and len(burst.frames) >= MIN_FRAMES and is_doubtful:
        offset, _ = estimate_offset(burst.frames, burst.valid & ~burst.bad_pixels)
        free = _candidates(UNREGISTERED, scorer, burst, one, offset)
    best = _best(found, free, raw, scorer, registered=registered)
    result.metrics["fixed_pattern_left"] = _figures(raw.whole.residual, best.residual)
    if best is found.whole:
        return kept
    message = Message(
        "correction-replaced",
        f"gain and offset as estimated leave a fixed pattern of {_said(found.whole.residual)} in "
        f"{'frames beside the burst' if burst.beside is not None else 'the frames'}, {best.name} "
        f"{_said(best.residual)}, uncorrected frames {_said(raw.whole.residual)}: the result has {best.name}"
        f"{_more_frames(burst)}",
    )
    if trusted and best is found.fine and result.scene.shape == burst.frames.shape:
        scene = (result.scene + found.low_order / result.gain).astype(np.float32)
        offset = best.offset.astype(np.float32)
        return dataclasses.replace(result, scene=scene, offset=offset, messages=[message, *result.messages])
    return _replaced(result, burst, best.gain, best.offset, message)


def unregistered(burst: Burst, refusal: DataError) -> Result:
    """A result for frames that do not register, but show the same things displaced; else `refusal` is raised again."""
    usable = burst.valid & ~burst.bad_pixels
    if len(burst.frames) < MIN_FRAMES or not usable.any():
        raise refusal
    offset, related = estimate_offset(burst.frames, usable)
    if not related:
        raise refusal
    one, zero = np.ones(burst.size), np.zeros(burst.size)
    scorer = _scorer(burst, [(one, offset)], np.zeros(len(burst.frames)))
    found = _candidates(UNREGISTERED, scorer, burst, one, offset)
    raw = _candidates("no correction", scorer, burst, one, zero)
    if found is None or raw is None:
        raise refusal
    best = _best(found, None, raw, scorer, registered=False)
    result = neutral(burst.frames[0], len(burst.frames), burst.size, burst.bad_pixels)
    result.metrics = {
        "iterations": 0,
        "evaluations": 0,
        "stop_reason": "the frames do not register as a whole",
        "fixed_pattern_left": _figures(raw.whole.residual, best.residual),
    }
    message = Message(
        "frames-not-registered",
        f"the frames do not register as a whole, but their parts move: the result has {best.name}. It leaves a fixed "
        f"pattern of {_said(best.residual)}, uncorrected frames {_said(raw.whole.residual)}{_more_frames(burst)}",
    )
    return _replaced(result, burst, best.gain, best.offset, message)


@dataclass(frozen=True)
class _Candidates:
    """A correction, the same without its low-order part, and that part at the frames' level, (h, w).

    `plausible`: whether a sensor may have so strong a low-order part.
    """

    whole: Correction
    fine: Correction
    low_order: Array
    plausible: bool

    @property
    def fine_nats(self) -> float:
        """Nats of the fine part; of the whole or the fine part where no fine part is judged."""
        judged = self.fine.residual.detail_nats
        return judged if not np.isnan(judged) else min(self.whole.residual.nats, self.fine.residual.nats)


def _candidates(name: str, scorer: CorrectionScorer, burst: Burst, gain: Array, offset: Array) -> _Candidates | None:
    """None if no pair of frames has known displacements."""
    level = float(np.median(burst.frames[burst.valid]))
    pattern, good = offset + (gain - 1) * level, ~burst.bad_pixels
    low_order = low_order_part(pattern, good)
    whole, fine = scorer.score(gain, offset), scorer.score(gain, offset - low_order)
    if whole is None or fine is None:
        return None
    short = Correction(f"{name}, without its low-order part", gain, offset - low_order, fine)
    return _Candidates(Correction(name, gain, offset, whole), short, low_order, not is_implausible(pattern, good))


def _best(
    found: _Candidates, free: _Candidates | None, raw: _Candidates, scorer: CorrectionScorer, *, registered: bool
) -> Correction:
    """The fine part of the one or the other, or none; with the low-order part of the one or the other, or none."""
    fine = found
    if free and free.fine_nats < found.fine_nats - MARGIN:
        fine = free
    if fine.fine_nats > raw.fine_nats:
        fine = raw
    best = raw.whole if fine is raw else fine.fine
    for each in filter(None, (found, free)):
        other = each.whole if each is fine else _mixed(fine, each, scorer)
        own, gain = each is fine and each.plausible, best.residual.nats - other.residual.nats
        if registered and own and each is found and each.whole.residual.nats <= raw.whole.residual.nats:
            taken = gain >= -MARGIN
        else:
            gains = best.residual.pair_nats - other.residual.pair_nats
            certain = len(gains) > 1 and gains.mean() > CERTAINTY * gains.std(ddof=1) / len(gains) ** 0.5
            taken = certain and gain >= (0.0 if own else MARGIN)
        if taken:
            best = other
    return raw.whole if best.residual.nats > raw.whole.residual.nats + MARGIN else best


def _mixed(fine: _Candidates, low_order: _Candidates, scorer: CorrectionScorer) -> Correction:
    """The fine part of one with the low-order part of another."""
    gain, offset = fine.fine.gain, fine.fine.offset + low_order.low_order
    name = f"{fine.whole.name}, with the low-order part of {low_order.whole.name}"
    residual = scorer.score(gain, offset)
    assert residual is not None  # the same frames have judged both
    return Correction(name, gain, offset, residual)


def _figures(raw: ResidualPattern, corrected: ResidualPattern) -> dict[str, float]:
    """What uncorrected and corrected frames leave, low-order and fine, for `metrics.json`."""
    found = {"raw": raw.change, "corrected": corrected.change}
    fine = {"raw_detail": raw.detail, "corrected_detail": corrected.detail}
    return found if np.isnan(raw.detail) else found | fine


def _more_frames(burst: Burst) -> str:
    """What to do with a burst that is a part of a recording."""
    return "" if burst.beside is None else ". deepir correct uses the whole recording"


def _said(residual: ResidualPattern) -> str:
    return f"{residual.change:.3g}" + ("" if np.isnan(residual.detail) else f" (fine {residual.detail:.3g})")


def _scorer(burst: Burst, corrections: list[tuple[Array, Array]], level: Array) -> CorrectionScorer:
    """Compares corrections by the frames beside the burst, or else by its own less their `level`, (N,)."""
    if burst.beside is not None:
        finite = np.isfinite(burst.beside)
        pairs = [(k, k + 1) for k in range(0, len(burst.beside), 2)]
        return CorrectionScorer(np.where(finite, burst.beside, 0), finite & ~burst.bad_pixels, pairs, corrections)
    count = len(burst.frames)
    pairs = [(k, k + gap) for gap in GAPS for k in range(count - gap)]
    pairs = pairs[:: max(1, -(-len(pairs) // OWN_PAIRS))]
    frames = burst.frames - np.nan_to_num(level).astype(np.float32)[:, None, None]
    return CorrectionScorer(frames, burst.valid & ~burst.bad_pixels, pairs, corrections, independent=False)


def _replaced(result: Result, burst: Burst, gain: Array, offset: Array, message: str) -> Result:
    """The result with another correction; its scene is the corrected first frame, or of each frame its own."""
    good = torch.from_numpy(burst.valid & ~burst.bad_pixels)[:, None]
    corrected = torch.from_numpy((burst.frames - offset) / gain)[:, None]
    own = result.scene.ndim == 3
    frames = corrected if own else corrected[:1]
    scene = torch.cat([fill_nearest(each[None], ok[None]) for each, ok in zip(frames, good, strict=False)])[:, 0]
    new = neutral((scene if own else scene[0]).numpy(), len(burst.frames), burst.size, burst.bad_pixels)
    if not own:
        new.frames_used[1:], new.motion[1:] = False, np.nan
    return dataclasses.replace(
        new,
        gain=gain.astype(np.float32),
        offset=offset.astype(np.float32),
        metrics=result.metrics,
        history=result.history,
        messages=[message, *(each for each in result.messages if getattr(each, "name", "") not in OF_ESTIMATE)],
    )
