"""The report of a corrected recording as one page of HTML, its verdict first."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepir.arrays import Array
from deepir.io.tone_mapping import PALETTES, WHITE_HOT
from deepir.messages import NOTES, by_importance, labelled
from deepir.paths import printable
from deepir.report.html import MAP_PALETTES, Verdict, colours, packed, warned, write_page

if TYPE_CHECKING:
    from deepir.recording.correct import CorrectedRecording
    from deepir.recording.estimate import SensorEstimate


def write_recording_report(
    path: Path, corrected: CorrectedRecording, source: str, unit: str, findings: Sequence[str]
) -> None:
    """Write the page.

    Args:
        path: The page.
        corrected: The recording.
        source: Its file.
        unit: Of its values; "" if it has none.
        findings: Lines on motion and offset.
    """
    data = {
        "title": "correction",
        "source": printable(Path(source).name),
        "verdict": {name: printable(each) for name, each in verdict(corrected, unit)._asdict().items()},
        "figures": list(_figures(corrected, unit)),
        "messages": [printable(each) for each in (*labelled(corrected.messages), *findings)],
        "maps": list(_maps(corrected, unit)),
        "palettes": {name: colours(name) for name in PALETTES},
        "others": {name: colours(each) for name, each in MAP_PALETTES.items()},
        "palette": WHITE_HOT,
    }
    write_page(path, "run.html", ("maps.js", "views.js", "run.js"), data)


def verdict(corrected: CorrectedRecording, unit: str) -> Verdict:
    """What was taken off and how sure that is; or what could not be told, and what to do."""
    estimate, bad = corrected.estimate, int(corrected.estimate.bad_pixels.sum())
    notes = [f"{text[:1].upper()}{text[1:]}." for name, text in by_importance(corrected.messages) if name in NOTES]
    filled = (
        f"{bad} bad pixel{'s are' if bad > 1 else ' is'} filled in." if bad else "No dead or stuck pixel was found."
    )
    filled, sentence = " ".join([*notes, filled]), _taken_off(corrected, unit)
    if found := warned(corrected.messages):
        leads = _is_little(estimate) and found.severity == "care"
        first, second = (sentence, found.sentence) if leads else (found.sentence, sentence)
        return Verdict(found.severity, first, f"{second} {found.more} {filled}")
    if len(corrected.segments) > 1:
        filled += f" The pattern jumps {len(corrected.segments) - 1} time(s); each part has maps of its own."
    if not np.isfinite(estimate.motion_error):
        filled += " Near and far things move differently here, so that shading is less sure than fine detail."
    return Verdict("good", sentence, filled)


def _is_little(estimate: SensorEstimate) -> bool:
    """Whether the pattern is weaker than the noise of one frame."""
    return estimate.pattern_deviations[0] < estimate.noise


def _taken_off(corrected: CorrectedRecording, unit: str) -> str:
    (was, now), noise = corrected.estimate.pattern_deviations, corrected.estimate.noise
    what = "the fine part of a" if corrected.estimate.is_fine else "a"
    removed = f"{what} fixed pattern of {was:.3g} {unit}".rstrip() + " (standard deviation) was removed"
    if _is_little(corrected.estimate):
        return f"There was little to correct: {removed}, weaker than the noise of one frame."
    if np.isfinite(now):
        removed += f"; about {now:.2g} {unit}".rstrip() + " may be left"
        removed += ", less than the noise of one frame" * bool(now < noise)
    return f"{removed[0].upper()}{removed[1:]}."


def _figures(corrected: CorrectedRecording, unit: str) -> Iterator[tuple[str, str]]:
    was, now = corrected.estimate.pattern_deviations
    yield "fixed pattern removed", f"{was:.3g} {unit}".rstrip()
    yield "may be left", f"{now:.2g} {unit}".rstrip() if np.isfinite(now) else "not known"
    if np.isfinite(corrected.estimate.noise):
        yield "noise of one frame", f"{corrected.estimate.noise:.2g} {unit}".rstrip()
    if spread := float(corrected.estimate.gain.std()):
        yield "spread of the gain", f"{100 * spread:.2g} %"
    yield "bad pixels", str(int(corrected.estimate.bad_pixels.sum()))
    yield "frames", str(len(corrected))


def _maps(corrected: CorrectedRecording, unit: str) -> Iterator[dict[str, Any]]:
    """A frame as recorded and corrected, what was taken off it, and the maps."""
    keyframes, estimate = corrected.keyframes, corrected.estimate
    k = len(keyframes.frames) // 2
    number, raw = int(keyframes.numbers[k]), keyframes.frames[k]
    after = corrected.correct(raw, number)
    yield packed("raw", "Recorded", raw, unit)
    yield packed("scene", "Corrected", after, unit)
    yield packed("difference", f"Taken off frame {number}", raw - after, unit, centre=0.0)
    yield packed("offset", "Offset", estimate.offset, unit, centre=0.0)
    if estimate.offset_deviation is not None:
        yield packed("offset_sd", "Uncertainty of the offset", estimate.offset_deviation, unit, "spread")
    yield packed("gain", "Gain", estimate.gain, "", centre=1.0)
    title = f"Bad pixels, {int(estimate.bad_pixels.sum())}, drawn larger"
    yield packed("bad_pixels", title, _wider(estimate.bad_pixels), "", "mask")


def _wider(bad: Array) -> Array:
    """Bad pixels (h, w) as squares that are seen in a picture of the page's size."""
    from scipy.ndimage import binary_dilation

    reach = max(1, bad.shape[1] // 200)
    return np.asarray(binary_dilation(bad, np.ones((2 * reach - 1, 2 * reach - 1), bool)))
