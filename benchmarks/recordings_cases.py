"""Recordings with something to judge a correction by: a truth, a calibrated film, or no pattern at all.

`DEEPIR_DATA` names the folder of real data (default ../shared/data). In the folder bench beside it, recordings.py makes
drives of a real film under drawn patterns, and windows of real pictures that are moved by hand.
"""

from __future__ import annotations

import functools
import importlib.util
import os
import re
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from nuc_store import code, kept
from recordings_methods import Correction
from recordings_scores import (
    Figures,
    alike,
    bad_pixels,
    covered,
    left_over,
    likeness,
    mean_error,
    taken_off,
)

import deepir
from deepir.simulate.recording import Recording, RecordingSettings, residual_map, simulate_recording
from deepir.simulate.recording.recording import RecordingTruth

Array = np.ndarray

DATA = Path(os.environ.get("DEEPIR_DATA", "../shared/data"))
DRAWN = DATA / ".." / "bench" / "recordings.py"
FAMILIES = ("hand-held", "agc", "drive", "simulated", "real", "corrected")

CAMERA = RecordingSettings(n_frames=240)  # at 30 frames a second
CAMERAS: dict[str, dict[str, Any]] = {
    "raw": {},
    "raw, shaded": {"shading": 0.6, "gain_pixel": 0.01},
    "after a shutter": {"shutter_every": 60.0, "drift": 0.01, "tau_ms": 10.0},
    "8 bits, lossy": {"agc": True, "compression": "h264"},
}
KINDS = ("drive", "walk", "pan", "drone")
JUDGED = 4  # frames, of which one is judged, of a simulated recording
JUDGED_FRAMES = 100  # of a real film, at most
PIECES = (50, 100, 200)  # frames
APART = 6  # frames at 60 Hz between two of a burst of one scene
BONNET = 420  # row of the A65's frames below which its car is seen


@dataclass(frozen=True)
class Case:
    """A recording, and how a correction of it is judged.

    Attributes:
        frames: (N, h, w), as they are recorded.
        judged: Numbers of the frames that are judged.
        judge: Figures of the corrected ones of them and of the correction.
        apart: Frames between two of a burst of one scene.
    """

    frames: Array
    judged: Array
    judge: Callable[[Array, Correction], Figures]
    apart: int


def names(family: str, seed: int) -> list[str]:
    """The recordings of a family that a seed draws; of real ones there are the same for each."""
    if family == "simulated":
        return [f"{kind}, {camera}" for kind in KINDS for camera in CAMERAS]
    if family in ("real", "corrected"):
        return list(_real_names(family))
    return [name for name in drawn().cases(str(DATA), seed) if _family(name) == family]


def missing(family: str) -> str:
    """Why a family cannot be run; empty if it can."""
    needed = {"simulated": [], "real": [DATA], "corrected": [DATA]}.get(family, [DATA, DRAWN])
    absent = [str(path) for path in needed if not path.exists()]
    return f"{absent[0]} is not there; DEEPIR_DATA names the folder of the data" if absent else ""


@functools.lru_cache(1)
def load(family: str, name: str, seed: int) -> Case:
    if family == "simulated":
        return _simulated(name, seed)
    if family == "real":
        return _lynred(name)
    if family == "corrected":
        return _without_pattern(name)
    return _drawn(name, seed)


def case_code(family: str) -> str:
    """What the recordings and their figures depend on."""
    patterns = ["../benchmarks/recordings_cases.py", "../benchmarks/recordings_scores.py"]
    patterns += ["simulate/**/*.py"] if family == "simulated" else []
    also = DRAWN.read_text() if family in ("hand-held", "agc", "drive") else ""
    return code(*patterns) + also


@functools.cache
def drawn() -> types.ModuleType:
    spec = importlib.util.spec_from_file_location("drawn_recordings", DRAWN)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _family(name: str) -> str:
    first = name.split(maxsplit=1)[0]
    return first if first in ("agc", "drive") else "hand-held"


def _drawn(name: str, seed: int) -> Case:
    """Hand-held, or a drive, under a drawn pattern."""
    frames, truth = drawn().cases(str(DATA), seed)[name]()
    no_bad = None if _family(name) == "drive" else np.zeros(frames.shape[1:], bool)

    def judge(corrected: Array, correction: Correction) -> Figures:
        figures = drawn().score(corrected, frames, truth)
        error = mean_error(corrected, truth["scene"], truth.get("gain"))
        return figures | covered(error, correction.deviation) | bad_pixels(correction.bad_pixels, no_bad)

    film = re.match(r"drive \d+x(\d+)", name)
    apart = max(1, APART // int(film[1])) if film else max(1, (len(frames) - 1) // 9)
    return Case(frames, np.arange(len(frames)), judge, apart)


def _simulated(name: str, seed: int) -> Case:
    kind, _, camera = name.partition(", ")
    settings = replace(CAMERA, kind=kind, **CAMERAS[camera])
    frames, some = _recording(settings, seed)
    pattern = residual_map(some.frames, some)
    before = likeness(some.frames, some.truth.scene)

    def judge(corrected: Array, correction: Correction) -> Figures:
        error = residual_map(corrected, some)
        like = {"likeness": likeness(corrected, some.truth.scene), "raw likeness": before}
        deviation = correction.deviation
        if deviation is not None:
            deviation = deviation / (some.truth.noise * np.median(some.truth.agc_gain))
        return (
            left_over(error, pattern)
            | like
            | {"sigmas": float(np.nanstd(error))}
            | covered(error, deviation)
            | bad_pixels(correction.bad_pixels, some.truth.bad_pixels)
        )

    return Case(frames, np.arange(0, len(frames), JUDGED), judge, max(1, APART // 2))


def _recording(settings: RecordingSettings, seed: int) -> tuple[Array, Recording]:
    """All frames, and the judged ones with their truth; kept, as simulating takes longer than correcting."""

    def make() -> dict[str, Array]:
        recording = simulate_recording(settings, seed=seed)
        truth = recording.truth
        some = {
            part: getattr(truth, part)[::JUDGED] for part in ("scene", "shutter", "agc_gain", "agc_offset")
        }
        whole = {part: np.asarray(getattr(truth, part)) for part in ("gain", "bad_pixels", "noise")}
        return {"frames": recording.frames, **some, **whole}

    stored = kept("recordings", [repr(settings), seed, JUDGED, code("simulate/**/*.py")], make)
    frames = stored.pop("frames")
    nothing = dict.fromkeys(("offset", "moving", "position", "rotation"), np.empty(0))
    truth = RecordingTruth(**(stored | {"noise": float(stored["noise"])} | nothing), focal=settings.focal)  # type: ignore[arg-type]
    return frames, Recording(frames[::JUDGED], np.empty(0), truth, settings, seed)


def _real_names(family: str) -> Iterator[str]:
    if family == "corrected":
        yield from ("a65", "lynred calibrated")
        yield from sorted(f"tensoristd {path.stem}" for path in (DATA / "tensoristd").glob("*.npz"))
        return
    length = len(lynred()[0])
    yield f"lynred 0:{length}"
    for size in PIECES:
        for first in range(0, length - size + 1, size):
            yield f"lynred {first}:{first + size}"


@functools.cache
def lynred() -> tuple[Array, Array, Array]:
    """A drive, raw and calibrated by a black body, (N, h, w) each, and its true pattern."""
    raw, calibrated = (
        deepir.read_frames(DATA / "lynred_car" / f"{name}.avi").frames.astype(np.uint8)
        for name in ("raw", "calibrated")
    )
    return raw, calibrated, true_pattern(raw, calibrated)


def true_pattern(raw: Array, calibrated: Array, rounds: int = 12) -> Array:
    """F of `raw = s calibrated + l + F`, by turns of least squares for s and l and the median over the frames."""
    some = np.arange(0, len(raw), 5)
    pattern = np.zeros(raw.shape[1:])
    for _ in range(rounds):
        rest = []
        for y, x in zip(raw[some], calibrated[some], strict=True):
            slope, level = np.polyfit(x.ravel()[::7].astype(float), (y - pattern).ravel()[::7], 1)
            rest.append(y - slope * x - level)
        pattern = np.median(rest, axis=0)
    return np.asarray(pattern - pattern.mean())


def _lynred(name: str) -> Case:
    first, last = (int(each) for each in name.split()[1].split(":"))
    raw, calibrated, pattern = lynred()
    frames, reference = raw[first:last], calibrated[first:last]
    judged = _some(len(frames))

    def judge(corrected: Array, correction: Correction) -> Figures:
        error = mean_error(corrected, frames[judged] - pattern)
        like = [
            float(np.median([alike(a, b) for a, b in zip(each, reference[judged], strict=True)]))
            for each in (corrected, frames[judged])
        ]
        return (
            left_over(error, pattern)
            | {"likeness": like[0], "raw likeness": like[1]}
            | covered(error, correction.deviation)
            | bad_pixels(correction.bad_pixels, None)
        )

    return Case(frames, judged, judge, APART)


def _without_pattern(name: str) -> Case:
    """A film that its makers have corrected: what is taken off is wrong, but for a small fine part."""
    kind, _, film = name.partition(" ")
    if kind == "a65":
        parts = [DATA / "a65" / f"a65_frames_{part}.npz" for part in ("000-009", "010-069")]
        frames = np.concatenate([np.load(part)["frames"] for part in parts])[:, :BONNET]
    else:
        frames = (
            np.load(DATA / "tensoristd" / f"{film}.npz")["frames"] if kind == "tensoristd" else lynred()[1]
        )
    judged = _some(len(frames))

    def judge(corrected: Array, correction: Correction) -> Figures:
        return taken_off(frames[judged], corrected) | bad_pixels(correction.bad_pixels, None)

    return Case(frames, judged, judge, APART if kind == "lynred" else 3)


def _some(length: int) -> Array:
    return np.unique(np.linspace(0, length - 1, min(length, JUDGED_FRAMES)).astype(int))
