"""What each effect of `nuc` is worth: `make bench-effects` leaves out one at a time, and compares with the truth.

On simulated bursts of what the effect is for, at three strengths; on clean bursts, where it is not needed; and on
bursts of hand-held recordings that are drawn from real pictures (`recordings_drawn.py`).
"""

from __future__ import annotations

import argparse
import functools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import recordings_drawn
import torch
from golden import error_db
from recordings_methods import BURST
from recordings_scores import MARGIN, mean_error
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.simulate import Settings, simulate

SCRIPT = "benchmarks/effects.py"
SEEDS = range(1, 6)
SMALL = {"shape": (80, 96), "n_frames": 6}
COUNTS = SMALL | {"counts": True}
CROPPED = np.s_[:, 20:100, 32:128]  # of a drawn recording

Array = np.ndarray
Judge = Callable[[Any], float]  # quality of a result, dB; of None, that of the raw frames


def stretched(frames: Array, deviation: float, rng: np.random.Generator) -> Array:
    """Frames with gains of their own, in 8 bits, as of an automatic gain control."""
    frames = own_gains(frames, deviation, rng)
    return np.round((frames - frames.min()) / np.ptp(frames) * 255).astype(np.uint8)


def own_gains(frames: Array, deviation: float, rng: np.random.Generator) -> Array:
    gains = 1 + deviation * rng.standard_normal(len(frames)).clip(-2, 2)
    return (frames.mean() + gains[:, None, None] * (frames - frames.mean())).astype(np.float32)


def dead_columns(frames: Array, count: int, rng: np.random.Generator) -> Array:
    first = rng.integers(10, frames.shape[2] - 20)
    frames[:, :, first : first + count] = frames.min()
    return frames


def overlay(frames: Array, side: int, rng: np.random.Generator) -> Array:
    y, x = (rng.integers(4, length - side - 4) for length in frames.shape[1:])
    frames[:, y : y + side, x : x + side] = np.median(frames)
    return frames


ALTERED = {each.__name__: each for each in (stretched, own_gains, dead_columns, overlay)}
#: Cameras, by the setting that varies; others are small ones, or have altered frames.
CAMERAS: dict[str, dict[str, Any]] = {
    "max_shift": COUNTS,
    "pedestal": COUNTS | {"dead_pixels": 0.01},
    "contrast": COUNTS | {"bolometer": True, "n_frames": 8},
    "gain_shading": SMALL | {"n_frames": 8},
}
#: Effect, what it is for, and strengths of that.
NEEDS = (
    ("frame_offset", "level_drift", (0.1, 0.5, 2.0)),
    ("unobserved", "max_shift", (5.0, 15.0, 30.0)),
    ("bad_pixels", "dead_columns", (1, 2, 4)),
    ("bad_pixels", "overlay", (5, 10, 20)),
    ("frame_gain", "stretched", (0.03, 0.1, 0.3)),
    ("saturation", "pedestal", (15000.0, 15400.0, 15800.0)),
    ("line_noise", "row_noise", (0.003, 0.01, 0.03)),
    ("moving_objects", "walker", (0.2, 0.4, 0.7)),
    ("reference_level", "contrast", (500.0, 1500.0, 4000.0)),
    ("gain_drift", "own_gains", (0.002, 0.01, 0.05)),
    ("vignetting", "gain_shading", (0.1, 0.3, 0.6)),
    ("shading", "shading", (0.1, 0.4, 1.0)),
    ("shading", "level_drift", (0.1, 0.5, 2.0)),
    ("outliers", "dead_pixels", (0.01, 0.03, 0.1)),
    ("noise", "read_noise", (0.001, 0.01, 0.03)),
    ("sensor_pattern", "offset_pixel", (0.01, 0.05, 0.2)),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument("--only", default="", help="effects whose name contains this")
    options = parser.parse_args()
    torch.set_num_threads(1)
    write(report(options.only), SCRIPT, options.output)


def report(only: str) -> Iterator[str]:
    """Lines of markdown."""
    yield "# What each effect is worth\n"
    yield "PSNR of the scene with an effect of `nuc` less that without it (`effects.NAME=false`, `prior=tv`), dB:"
    yield f"median of {len(SEEDS)} seeds (worst to best). Bursts of what it is for, weak to strong; clean bursts; ten"
    yield "frames of hand-held recordings of real pictures, by the pattern left. Last: CPU seconds on a clean burst.\n"
    yield "| effect | for | weak | medium | strong | clean | drawn | s |"
    yield "|---|---|---|---|---|---|---|---|"
    is_drawn = not recordings_drawn.missing("hand-held")
    for effect, what, strengths in NEEDS:
        if only in effect:
            kinds = [*((what, each) for each in strengths), ("clean", 0.0), *[("drawn", 0.0)] * is_drawn]
            changes = {kind: np.array([changed(effect, *kind, seed) for seed in SEEDS]) for kind in kinds}
            words = [
                f"{np.median(x):+.2f} ({x.min():+.2f} to {x.max():+.2f})"
                for x, _ in (each.T for each in changes.values())
            ]
            words += [""] * (not is_drawn)
            name = f"{what.replace('_', ' ')} {', '.join(f'{each:g}' for each in strengths)}"
            seconds = np.median(changes["clean", 0.0][:, 1])
            yield f"| {' | '.join([f'`{effect}`', name, *words, f'{seconds:+.2f}'])} |"


def changed(effect: str, what: str, strength: float, seed: int) -> tuple[float, float]:
    """What an effect adds to the quality of a burst, dB, and to its CPU seconds."""
    (better, longer), (worse, shorter) = (quality(what, strength, seed, each) for each in ("", effect))
    return better - worse, longer - shorter


@functools.cache
def quality(what: str, strength: float, seed: int, without: str) -> tuple[float, float]:
    """Quality of a burst's result without an effect, dB, and CPU seconds."""
    frames, judge = drawn(seed) if what == "drawn" else simulated(what, strength, seed)
    settings = [f"effects.{without}=false"] if without else []
    began = time.process_time()
    try:
        result = deepir.run("nuc", "prior=tv", *settings, frames=frames)
    except (DeepIRError, torch.linalg.LinAlgError):
        result = None
    return judge(result), time.process_time() - began


def simulated(what: str, strength: float, seed: int) -> tuple[Array, Judge]:
    camera = CAMERAS.get(what, SMALL)
    if what == "clean":
        camera = camera | {"dead_pixels": 0.0, "shading": 0.0}
    elif what not in ALTERED:
        camera = camera | {what: strength}
    burst = simulate(settings=Settings(**camera), seed=seed)
    frames, truth = burst.frames, burst.truth.scene
    if what in ALTERED:
        frames = ALTERED[what](frames.copy(), strength, np.random.default_rng(seed))

    def judge(result: Any) -> float:
        scene = frames[0] if result is None else result.scene
        gain, level = np.polyfit(scene.ravel().astype(float), truth.ravel(), 1)  # stretched frames have their own
        return error_db(gain * scene + level, truth)

    return frames, judge


def drawn(seed: int) -> tuple[Array, Judge]:
    """Ten frames of a hand-held recording: another kind of path, and of pattern, for each seed."""
    names = recordings_drawn.names("hand-held", seed)
    make = recordings_drawn.drawn().cases(str(recordings_drawn.DATA), seed)[names[7 * seed % len(names)]]
    frames, truth = make()
    used = np.linspace(0, len(frames) - 1, BURST).astype(int)
    frames, scene, pattern = (frames[used][CROPPED], truth["scene"][used][CROPPED], truth["pattern"][CROPPED[1:]])

    def judge(result: Any) -> float:
        corrected = frames if result is None else (frames - result.offset) / result.gain
        left = mean_error(corrected, scene)[MARGIN:-MARGIN, MARGIN:-MARGIN]
        return float(20 * np.log10(pattern.std() / left.std()))

    return frames, judge


if __name__ == "__main__":
    main()
