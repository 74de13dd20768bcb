"""The simulator's recordings, of several cameras: a truth with gain, drift, lag, bad pixels, and lossy films."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from nuc_store import code, kept
from recordings_cases import APART, Case
from recordings_methods import Correction
from recordings_scores import Figures, bad_pixels, covered, left_over, likeness

from deepir.simulate.recording import Recording, RecordingSettings, RecordingTruth, residual_map, simulate_recording

FAMILIES = ("simulated",)
CODE = ("recordings_simulated.py", "../deepir/simulate/**/*.py")
CAMERA = RecordingSettings(n_frames=240)  # at 30 frames a second
CAMERAS: dict[str, dict[str, Any]] = {
    "raw": {},
    "raw, shaded": {"shading": 0.6, "gain_pixel": 0.01},
    "after a shutter": {"shutter_every": 60.0, "drift": 0.01, "tau_ms": 10.0},
    "8 bits, lossy": {"agc": True, "compression": "h264"},
}
KINDS = ("drive", "walk", "pan", "drone")
STRIDE = 4  # frames, of which one is judged


def missing(family: str) -> str:
    return ""


def names(family: str, seed: int) -> list[str]:
    return [f"{kind}, {camera}" for kind in KINDS for camera in CAMERAS]


def load(family: str, name: str, seed: int) -> Case:
    kind, _, camera = name.partition(", ")
    frames, some = _recording(replace(CAMERA, kind=kind, **CAMERAS[camera]), seed)
    truth = some.truth
    pattern, good = residual_map(some.frames, some), ~truth.bad_pixels
    before = likeness(some.frames, truth.scene, good)

    def judge(corrected: np.ndarray, correction: Correction) -> Figures:
        error = residual_map(corrected, some)  # in sigmas of the noise
        deviation = correction.deviation
        if deviation is not None:
            deviation = deviation / (truth.noise * np.median(truth.agc_gain))
        return {
            **left_over(error, pattern),
            "likeness": likeness(corrected, truth.scene, good),
            "raw likeness": before,
            "sigmas": float(np.nanstd(error)),
            **covered(error, deviation),
            **bad_pixels(correction.bad_pixels, truth.bad_pixels),
        }

    return Case(frames, np.arange(0, len(frames), STRIDE), judge, APART // 2)


def _recording(settings: RecordingSettings, seed: int) -> tuple[np.ndarray, Recording]:
    """All frames, and the judged ones with their truth; kept, as simulating takes longer than correcting."""

    def make() -> dict[str, np.ndarray]:
        recording = simulate_recording(settings, seed=seed)
        truth = recording.truth
        parts = ("scene", "shutter", "agc_gain", "agc_offset")
        some = {part: getattr(truth, part)[::STRIDE] for part in parts}
        whole = {part: np.asarray(getattr(truth, part)) for part in ("gain", "bad_pixels", "noise")}
        return {"frames": recording.frames, **some, **whole}

    stored: dict[str, Any] = kept("recordings", [repr(settings), seed, STRIDE, code("simulate/**/*.py")], make)
    frames = stored.pop("frames")
    stored["noise"] = float(stored["noise"])
    unused = dict.fromkeys(("offset", "moving", "position", "rotation"), np.empty(0))
    truth = RecordingTruth(**stored, **unused, focal=settings.focal)
    return frames, Recording(frames[::STRIDE], truth, settings, seed, np.empty(0))
