"""What `deepir correct` says of scene and camera, against the truth of simulated recordings: `make bench-physics`.

Kinds of recordings in turn; lag, gain and how frames are stored are drawn. Confusion matrices: what is, what was said.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from deepir.recording.parallax import PARALLAX_RATIO
from scipy import ndimage
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.simulate.recording import RecordingSettings, simulate_recording
from deepir.simulate.recording.camera import compress
from deepir.simulate.recording.settings import RECORDING_KINDS

SCRIPT = "benchmarks/physics_choice.py"
RECORDINGS = 100
FIRST_SEED = 1000
SHAPE = (96, 128)
FRAMES = {"pan": 160}  # a pan rests half of the time
SHORT = 96  # frames of the others
STORED = ("14 bits", "14 bits", "8 bits", "8 bits, AGC", "8 bits, AGC, lossy")
TAU_MS = 10.0  # of those that lag: 0.3 frames
#: From far above the ground, or from a fixed place, a homography is right.
WITH_PARALLAX = ("drive", "walk")
GREY = (16.0, 224.0)  # grey level of the darkest samples, and levels to the brightest
AGC_DEVIATION, AGC_FRAMES = 0.15, 15.0  # deviation of the logarithm of the gain, and over which it changes


@dataclass(frozen=True)
class Truth:
    """Of a recording."""

    kind: str
    stored: str
    lag: bool
    gain: bool


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument("--recordings", type=int, default=RECORDINGS)
    options = parser.parse_args()
    write(report(options.recordings), SCRIPT, options.output)


def report(count: int) -> Iterator[str]:
    """Lines of markdown: a row for each recording, then the confusion matrices."""
    answers: dict[str, Counter[tuple[str, str]]] = {}
    yield "# Choice of physics\n"
    yield f"Frames of {SHAPE[1]} x {SHAPE[0]}; {SHORT} of them, {FRAMES['pan']} of a pan.\n"
    yield "| recording | kind | stored | is | said | figures |\n|---|---|---|---|---|---|"
    for number in range(count):
        frames, truth = recording(number)
        said, figures = judged(frames)
        true = {name: value for name, value in answers_of(truth).items() if name in said}
        for name, value in true.items():
            answers.setdefault(name, Counter())[value, said[name]] += 1
        cells = (", ".join(each[name] for name in true) for each in (true, said))
        yield f"| {number} | {truth.kind} | {truth.stored} | {' | '.join(cells)} | {figures} |"
    for name, counts in answers.items():
        yield from matrix(name, counts)


def recording(number: int) -> tuple[np.ndarray, Truth]:
    """Frames and what is true of them."""
    rng = np.random.default_rng(FIRST_SEED + number)
    kind = RECORDING_KINDS[number % len(RECORDING_KINDS)]
    lag, stored, gain = bool(rng.integers(2)), str(rng.choice(STORED)), bool(rng.integers(2))
    camera: dict[str, Any] = {"tau_ms": TAU_MS, "substeps": 4} if lag else {}
    camera |= {} if gain else {"gain_pixel": 0.0, "gain_column": 0.0}
    settings = RecordingSettings(kind=kind, n_frames=FRAMES.get(kind, SHORT), shape=SHAPE, **camera)
    frames = simulate_recording(settings, seed=number).frames
    return as_stored(frames, stored, settings, rng), Truth(kind, stored, lag, gain)


def as_stored(
    frames: np.ndarray, stored: str, settings: RecordingSettings, rng: np.random.Generator
) -> np.ndarray:
    """Counts, or grey levels of a fixed window, or of one that an automatic gain control changes."""
    if stored == "14 bits":
        return frames
    low, high = np.percentile(frames, (0.5, 99.5))
    logs = ndimage.gaussian_filter1d(rng.standard_normal(len(frames)), AGC_FRAMES)
    spread = AGC_DEVIATION * (logs - logs.mean()) / logs.std() if "AGC" in stored else np.zeros(len(frames))
    middle, scale = (low + high) / 2, GREY[1] / (high - low) * np.exp(spread - spread.max())
    grey = np.rint(scale[:, None, None] * (frames - middle) + sum(GREY) / 2)
    found = grey.clip(0, 255).astype(np.uint8)
    if "lossy" not in stored:
        return found
    return compress(found, RecordingSettings(agc=True, compression="h264", frame_rate=settings.frame_rate))


def answers_of(truth: Truth) -> dict[str, str]:
    """The right answers, by question."""
    return {
        "camera": "rests" if truth.kind == "tripod" else "moves",
        "parallax": "yes" if truth.kind in WITH_PARALLAX else "no",
        "lag": "yes" if truth.lag else "no",
        "AGC": "yes" if "AGC" in truth.stored else "no",
        "pattern": "gain and offset" if truth.gain else "offset only",
    }


def judged(frames: np.ndarray) -> tuple[dict[str, str], str]:
    """What is said of a recording, by question, and the figures; where the camera rests, nothing else is asked."""
    try:
        corrected = deepir.correct(frames)
    except DeepIRError as error:
        return {"camera": "rests" if "stands still" in str(error) else "refused"}, ""
    estimate, lag = corrected.estimate, corrected.lag
    with_gain = estimate.kept == "gain_and_offset"
    said = {
        "camera": "moves",
        "parallax": "yes" if estimate.parallax > PARALLAX_RATIO else "no",
        "lag": "yes" if lag is not None and lag.is_seen else "no",
        "AGC": "yes" if estimate.strength is not None else "no",
    }
    if estimate.strength is None:  # else no gain is sought
        said["pattern"] = "gain and offset" if with_gain else "offset only"
    figures = f"ratio {estimate.parallax:.2f}"
    return said, figures + (f", lag {lag.time_constant:.2f} ({lag.nats:.1f} nats)" if lag else "")


def matrix(name: str, counts: Counter[tuple[str, str]]) -> Iterator[str]:
    """A confusion matrix, and how many answers are right."""
    said = sorted({each for _, each in counts})
    right = sum(count for (true, each), count in counts.items() if true == each)
    yield f"\n## {name}: {right} of {counts.total()} right\n"
    yield f"| is | said: {' | '.join(said)} |\n|---|" + "---|" * len(said)
    for true in sorted({each for each, _ in counts}):
        yield f"| {true} | {' | '.join(str(counts[true, each]) for each in said)} |"


if __name__ == "__main__":
    main()
