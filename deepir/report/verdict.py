"""Whether a result can be trusted, in one sentence: from its messages and its figures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepir.io.radiometry import unit_metadata
from deepir.messages import DISTRUSTED, NOTES, WARNINGS, by_importance

if TYPE_CHECKING:
    from deepir.result import Result


class Verdict(NamedTuple):
    """Good, care or bad; the sentence; and what there is to say or to do beside."""

    severity: str
    sentence: str
    more: str


def verdict(result: Result) -> Verdict:
    """The verdict on a result: its most important warning, or what it reached."""
    warnings = [each for each in by_importance(result.messages) if each[0] not in NOTES]
    if not warnings:
        return Verdict("good", _reached(result), _frames(result))
    (name, text), more = warnings[0], len(warnings) - 1
    meaning, advice = WARNINGS.get(name, (text, ""))
    what, _, rest = meaning.partition(". ")
    severity = "bad" if name in DISTRUSTED else "care"
    start = {"bad": "Do not trust this result", "care": "Use this result with care"}[severity]
    others = f"{more} more warning{'s are' if more > 1 else ' is'} below." if more else ""
    sentence = f"{start}: {what[:1].lower()}{what[1:].rstrip('.')}."
    return Verdict(severity, sentence, " ".join(filter(None, (rest, advice, others))))


def _reached(result: Result) -> str:
    """What an untroubled result has reached, in a sentence."""
    left: dict[str, Any] = result.metrics.get("fixed_pattern_left") or {}
    if {"raw", "corrected"} <= left.keys():
        unit = str(unit_metadata(result.radiometry).get("unit", ""))
        was = f"{left['raw']:.3g} {unit}".strip()
        return f"The pattern was separated from the scene: {was} before, {left['corrected']:.3g} after."
    if np.ptp(result.gain) or np.ptp(result.offset):
        return "The pattern was separated from the scene."
    return "Nothing speaks against this result."


def _frames(result: Result) -> str:
    used, count = int(result.frames_used.sum()), len(result.frames_used)
    return "All frames are used." if used == count else f"{used} of {count} frames are used."
