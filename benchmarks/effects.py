"""What each effect is worth: `make bench-effects` leaves one out at a time, on simulated and on real bursts.

Simulated: PSNR of the scene, against truth, in dB; bursts that have the imperfection, and plain ones. Real: likeness of
corrected frames with the calibrated ones on the drive that `DEEPIR_DATA` holds, over frames that were not used.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from golden import error_db
from recordings_cases import DATA
from recordings_scores import alike
from written import write

import deepir
from deepir.config import load
from deepir.errors import DeepIRError
from deepir.pipeline.schedule import make_recipe
from deepir.registry import components, summary
from deepir.simulate import Settings, simulate

SCRIPT = "benchmarks/effects.py"
SMALL = {"shape": (80, 96), "n_frames": 6}
COUNTS = SMALL | {"counts": True}
#: Name: the camera. The first two have nothing special.
BURSTS: dict[str, dict[str, Any]] = {
    "plain": SMALL,
    "counts": COUNTS,
    "saturated": COUNTS | {"pedestal": 15500.0},
    "dead pixels": SMALL | {"dead_pixels": 0.03, "stuck_pixels": 0.01},
    "level drift": SMALL | {"level_drift": 0.02},
    "jumping rows": SMALL | {"row_noise": 0.02},
    "strong shading": SMALL | {"shading": 0.6},
    "vignetting": SMALL | {"n_frames": 8, "gain_shading": 0.3},
    "moving object": SMALL | {"walker": 0.4},
    "strong pattern": SMALL | {"offset_pixel": 0.2, "offset_column": 0.2},
    "failed frame": SMALL | {"failed_frame": 3},
    "bolometer": COUNTS | {"bolometer": True, "n_frames": 8},
    "faint": COUNTS | {"contrast": 100.0},
    "photons": SMALL | {"photons": 2000.0},
}
#: Each frame of these bursts is stretched, or has a response of its own.
STRETCHED = {"AGC": 0.15, "gain drift": 0.004}
SEEDS = (31,)
DRIVE = [range(30, 90, 6)]  # frames of the real drive
SKIP = 17  # frames between those that likeness is taken of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument("--no-real", action="store_true", help="simulated bursts only")
    options = parser.parse_args()
    torch.set_num_threads(2)
    write(report(real=not options.no_real and DATA.is_dir()), SCRIPT, options.output)


def report(*, real: bool) -> Iterator[str]:
    """Lines of markdown."""
    yield "# What each effect is worth\n"
    yield "`make bench-effects` leaves out one effect of `nuc` at a time (`effects.NAME=false`)."
    yield "Simulated: change of the scene's PSNR, dB, over 16 kinds of bursts. Real: change of likeness"
    yield "with the calibrated frames on a drive. Seconds: of the simulated bursts, all effects first.\n"
    began = time.monotonic()
    whole = simulated([])
    drive = driven([]) if real else []
    yield f"| effect | what it is | mean, dB | largest changes, dB | real | s, of {time.monotonic() - began:.0f} |"
    yield "|---|---|---|---|---|---|"
    kinds = {kind: name for name, kind in components("effect").items()}
    for effect in make_recipe(load("nuc")).effects:
        name, began = kinds[type(effect)], time.monotonic()
        found = simulated([f"effects.{name}=false"])
        seconds = time.monotonic() - began
        change = {burst: found[burst] - whole[burst] for burst in whole}
        largest = sorted(change, key=lambda burst: -abs(change[burst]))[:3]
        words = ", ".join(f"{burst} {change[burst]:+.1f}" for burst in largest if abs(change[burst]) >= 0.05)
        also = driven([f"effects.{name}=false"]) if real else []
        on_real = ", ".join(f"{b - a:+.3f}" for a, b in zip(drive, also, strict=True))
        mean = np.mean(list(change.values()))
        yield f"| `{name}` | {summary(type(effect))} | {mean:+.2f} | {words} | {on_real} | {seconds:.0f} |"


def simulated(settings: list[str]) -> dict[str, float]:
    """PSNR of the scene of each kind of burst, dB; the mean over the seeds. A burst that fails has the raw frame's."""
    found = {}
    for name in [*BURSTS, *STRETCHED]:
        each = []
        for seed in SEEDS:
            burst = simulate(settings=Settings(**BURSTS.get(name, SMALL)), seed=seed)
            frames = burst.frames
            if name in STRETCHED:
                gains = 1 + STRETCHED[name] * np.random.default_rng(seed).standard_normal(len(frames))
                frames = (frames.mean() + gains[:, None, None] * (frames - frames.mean())).astype(np.float32)
            if name == "AGC":
                low, high = frames.min((1, 2), keepdims=True), frames.max((1, 2), keepdims=True)
                frames = ((frames - low) / (high - low)).astype(np.float32)
            try:
                scene = deepir.run("nuc", *settings, frames=frames).scene
            except (DeepIRError, torch.linalg.LinAlgError):
                scene = frames[0]
            truth = burst.truth.scene
            gain, offset = np.polyfit(
                scene.ravel(), truth.ravel(), 1
            )  # stretched frames have a gain of their own
            each.append(error_db(gain * scene + offset, truth))
        found[name] = float(np.mean(each))
    return found


def driven(settings: list[str]) -> list[float]:
    """Likeness with the calibrated frames at places of the drive."""
    raw, calibrated = (
        deepir.read_frames(DATA / "lynred_car" / f"{name}.avi").frames for name in ("raw", "calibrated")
    )
    found = []
    for used in DRIVE:
        others = np.setdiff1d(np.arange(0, len(raw), SKIP), used)
        result = deepir.run("nuc", *settings, frames=raw, data={"frames": list(used)})
        found.append(
            float(np.median([alike((raw[k] - result.offset) / result.gain, calibrated[k]) for k in others]))
        )
    return found


if __name__ == "__main__":
    main()
