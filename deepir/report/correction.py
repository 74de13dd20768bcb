"""One picture of a corrected recording: frames before and after, and what was corrected."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deepir.io import atomic_file
from deepir.report.panels import Panel, write_panels

if TYPE_CHECKING:
    from deepir.recording.correct import CorrectedRecording

Array = np.ndarray[Any, Any]

SHOWN = (0.1, 0.5, 0.9)  # places in the recording of the frames shown
PERCENTILES = (0.5, 99.5)  # of a picture's values, shown black and white


def write_correction(path: Path, corrected: CorrectedRecording) -> None:
    """Write the picture: three frames as recorded, the same corrected, and offset, gain and bad pixels."""
    keyframes = corrected.keyframes
    chosen = [int(place * (len(keyframes.frames) - 1)) for place in SHOWN]
    before = [keyframes.frames[k] for k in chosen]
    numbers = [int(keyframes.numbers[k]) for k in chosen]
    after = [corrected.correct(*each) for each in zip(before, numbers, strict=True)]
    estimate = corrected.estimate
    panels = [
        *(_panel(f"frame {number}, recorded", frame) for number, frame in zip(numbers, before, strict=True)),
        *(_panel(f"frame {number}, corrected", frame) for number, frame in zip(numbers, after, strict=True)),
        _panel(f"offset, std {estimate.offset[~estimate.bad_pixels].std():.3g}", estimate.offset),
        _panel(f"gain, std {100 * estimate.gain[~estimate.bad_pixels].std():.2g} %", estimate.gain),
        ("bad pixels", estimate.bad_pixels.astype(float), 0.0, 1.0),
    ]
    with atomic_file(path) as part:
        write_panels(part, panels, rows=3)


def _panel(title: str, picture: Array) -> Panel:
    low, high = (float(each) for each in np.nanpercentile(picture, PERCENTILES))
    if low == high:  # a uniform picture is grey
        low, high = low - 0.5, high + 0.5
    return title, picture, low, high
