"""Corrections of recordings, real ones judged by frames that they did not use: `make bench-real`.

Lynred: a drive, raw and calibrated by a black body; likeness is the median correlation of corrected frames with the
calibrated ones. A65: a drive with a factory's correction; the correlation of the fine detail of frames far apart, which
only a fixed pattern has. The others: what is left along displacements of frames beside the burst. `DEEPIR_DATA` names
the folder of the data (default ../shared/data). Simulated ones are judged by their truth and need no data.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.multiview.held_out_pattern import CorrectionScorer, ResidualPattern
from deepir.result import Result
from deepir.simulate.recording import Recording, RecordingSettings, residual_map, simulate_recording
from deepir.simulate.recording.settings import RECORDING_KINDS

SCRIPT = "benchmarks/recordings.py"
DATA = Path(os.environ.get("DEEPIR_DATA", "../shared/data"))
#: (first frame, frames apart, frames) of the drive: nothing was chosen by these.
OVER_THE_CLIP = [(3, 37, 16), (7, 36, 16), (13, 38, 16), (25, 36, 16), (32, 35, 16), (40, 36, 16)]
NEAR = [(s, 6, 10) for s in (30, 150, 270, 390, 510)] + [(190, 8, 20)]
FEW = [(s, 6, 5) for s in (20, 100, 220, 340, 460)]
MANY = [(9, 14, 40)]
METHODS: dict[str, tuple[str, ...]] = {
    "nuc": ("nuc",),
    "flow": ("flow",),
    "multiview_nuc": ("multiview_nuc", "solver.max_iterations=2"),
    "multiview_tv": ("multiview_nuc", "method=multiview_tv"),
    "gradient_consensus": ("multiview_nuc", "method=gradient_consensus"),
}
#: Those that take the frames for a burst of one scene.
BURSTS = ("nuc", "flow")
BONNET = 420  # row of the A65's frames below which its car is seen
#: Recordings at hand.
MOVING = {
    "lynred": "lynred_car/raw.avi",
    "a65, first": "a65/a65_frames_000-009.npz",
    "a65, others": "a65/a65_frames_010-069.npz",
    "lepton": "lepton/lepton_tlinear_82x120x160.npz",
    "lepton, CPTV": "lepton/v2.cptv",
}
DRAWN_SEED = 11
#: Method, frames, frames apart, and how often.
DRAWS: list[tuple[str, int, list[int], int]] = [
    ("nuc", 5, [1, 3, 6], 4),
    ("nuc", 10, [1, 3, 6], 6),
    ("flow", 5, [1, 3, 6], 4),
    ("flow", 10, [1, 3, 6], 4),
    ("multiview_nuc", 8, [4, 7, 20, 60], 6),
]
#: A camera whose shutter has closed just before, and whose offset drifts since.
CAMERA = RecordingSettings(n_frames=240, shape=(160, 200), shutter_every=60.0, drift=0.01, tau_ms=10.0)
STORED: dict[str, dict[str, Any]] = {
    "14 bits": {},
    "8 bits, lossy": {"agc": True, "compression": "h264"},
}
SIMULATED_SEED = 5
TAKEN = 16  # frames of a simulated recording that a correction is found on
METHODS_OF_SCENES = [name for name in METHODS if name not in BURSTS]
SKIP = 17  # frames between those that likeness is taken of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    parser.add_argument(
        "--only", choices=["drive", "a65", "drawn", "simulated"], help="one part of the report"
    )
    options = parser.parse_args()
    if not DATA.is_dir() and options.only != "simulated":
        raise SystemExit(f"{DATA} is not there: set DEEPIR_DATA to the folder of the data")
    parts = {"drive": drive, "a65": a65, "drawn": drawn, "simulated": simulated}
    write(report([parts[options.only]] if options.only else list(parts.values())), SCRIPT, options.output)


def report(parts: Sequence[Callable[[], Iterator[str]]]) -> Iterator[str]:
    """Lines of markdown."""
    for part in parts:
        yield from part()


def drive() -> Iterator[str]:
    """Likeness with the calibrated frames, and of the pattern with the true one."""
    raw, calibrated = (
        deepir.read_frames(DATA / "lynred_car" / f"{name}.avi").frames for name in ("raw", "calibrated")
    )
    truth = true_pattern(raw, calibrated)
    yield "\n## Lynred, a drive\n"
    yield "Median likeness with the calibrated frames (least in brackets) and fine correlation of the pattern.\n"
    yield f"| frames | raw | true pattern | {' | '.join(METHODS)} |"
    yield "|---|---|---|" + "---|" * len(METHODS)
    rows: list[str] = []
    for name, places in {
        "10 to 20 near": NEAR,
        "5 near": FEW,
        "16 over the clip": OVER_THE_CLIP,
        "40 over the clip": MANY,
    }.items():
        found: dict[str, list[tuple[float, float]]] = {method: [] for method in METHODS}
        for start, step, count in places:
            used = start + step * np.arange(count)
            others = np.setdiff1d(np.arange(0, len(raw), SKIP), used)

            def like(correct: Callable[[np.ndarray], np.ndarray], others: np.ndarray = others) -> float:
                return float(np.median([alike(correct(raw[k]), calibrated[k]) for k in others]))

            for method, how in METHODS.items():
                problem, *settings = how
                if method in BURSTS and "over" in name:
                    continue
                choice = f"data.frames={','.join(map(str, used))}"
                try:
                    result = deepir.run(
                        problem, *settings, frames=raw, data={"frames": [int(k) for k in used]}
                    )
                except DeepIRError as error:
                    rows.append(f"| {method} | {choice} | refused: {str(error)[:60]} |")
                    continue
                pattern = (result.gain - 1) * np.median(raw[used]) + result.offset
                likeness = like(lambda frame, r=result: (frame - r.offset) / r.gain)
                found[method].append((likeness, alike(fine(pattern), fine(truth))))
                rows.append(
                    f"| {method} | {start}::{step} x {count} | {likeness:.3f} | {found[method][-1][1]:.3f} | "
                    f"{said(*judged(raw, used, result))} | {given_up(result)} |"
                )
                print(rows[-1], flush=True)
        columns = [
            f"{np.median([a for a, _ in each]):.3f} ({min(a for a, _ in each):.2f}), "
            f"{np.median([b for _, b in each]):.3f}"
            if each
            else ""
            for each in found.values()
        ]
        yield f"| {name} | {like(lambda f: f):.2f} | {like(lambda f: f - truth):.3f} | {' | '.join(columns)} |"
    yield "\nEach run: what is left in frames beside the burst, slow and fine, before and after.\n"
    yield "| method | frames | likeness | fine | slow | fine pattern | given up |\n|---|---|---|---|---|---|---|"
    yield from rows


def judged(
    frames: np.ndarray, used: np.ndarray, result: Result
) -> tuple[ResidualPattern | None, ResidualPattern | None]:
    """What raw and corrected frames beside the burst leave."""
    beside = np.setdiff1d(np.arange(used[0] + 1, min(used[-1] + 10, len(frames) - 4)), used)[::3][:6]
    pairs = np.stack((beside, np.minimum(beside + 4, len(frames) - 1)), 1)
    some = frames[pairs.ravel()]
    scorer = CorrectionScorer(
        some,
        np.ones(some.shape, bool),
        [(2 * k, 2 * k + 1) for k in range(len(beside))],
        [(result.gain, result.offset)],
    )
    raw = scorer.score(np.ones_like(result.gain), np.zeros_like(result.offset))
    return raw, scorer.score(result.gain, result.offset)


def said(before: ResidualPattern | None, after: ResidualPattern | None) -> str:
    """Two cells of a table: of what is slow, and of the fine pattern."""
    if before is None or after is None:
        return "not judged | "
    return f"{before.change:.3g} to {after.change:.3g} | {before.detail:.3g} to {after.detail:.3g}"


def given_up(result: Result) -> str:
    """What the run says that it gave up."""
    said = [m for m in result.messages if "fixed pattern of" in m]
    return said[0].partition("the result has ")[2].partition(". It")[0] if said else ""


def a65() -> Iterator[str]:
    """Maps found on some frames, applied to others."""
    frames = np.concatenate(
        [
            deepir.read_frames(DATA / "a65" / f"a65_frames_{part}.npz").frames
            for part in ("000-009", "010-069")
        ]
    )[:, :BONNET]
    yield "\n## FLIR A65, a drive, corrected by its factory\n"
    yield "Correlation of the fine detail of frames 21 to 29 apart, with maps of other frames.\n"
    yield "| frames | method | raw | corrected | given up |\n|---|---|---|---|---|"
    for name, used in {"0 to 9": np.arange(10), "every sixth": np.arange(0, 60, 6)}.items():
        for method, how in METHODS.items():
            problem, *settings = how
            try:
                result = deepir.run(
                    problem, *settings, frames=frames, data={"frames": [int(k) for k in used]}
                )
            except DeepIRError as error:
                yield f"| {name} | {method} | | refused: {str(error)[:60]} | |"
                continue
            corrected = (frames - result.offset) / result.gain
            pairs = [(40, 69), (44, 65)] if name == "0 to 9" else [(40, 69), (45, 65)]
            before, after = (
                np.mean([detail_correlation(each[i], each[j]) for i, j in pairs])
                for each in (frames, corrected)
            )
            yield f"| {name} | {method} | {before:.3f} | {after:.3f} | {given_up(result)} |"


def drawn() -> Iterator[str]:
    """Runs at drawn positions: no correction may leave more than none."""
    generator = np.random.default_rng(DRAWN_SEED)
    recordings = {name: deepir.read_frames(DATA / path).frames for name, path in MOVING.items()}
    recordings["a65"] = np.concatenate([recordings.pop(name) for name in ("a65, first", "a65, others")])
    yield "\n## Drawn positions\n"
    yield "What is left in frames beside the burst, slow and fine, before and after; bold where it is more.\n"
    yield "| method | recording | frames | slow | fine pattern | given up |\n|---|---|---|---|---|---|"
    count = worse = 0
    for name, frames in recordings.items():
        for method, size, steps, times in DRAWS:
            short = [each for each in steps if each * size < len(frames) - 8]
            for _ in range(times if name == "lynred" else times // 2):
                step = int(generator.choice(short)) if short else 1
                start = int(generator.integers(0, max(1, len(frames) - step * size - 8)))
                used = start + step * np.arange(size)
                place = f"| {method} | {name} | {start}::{step} x {size} |"
                try:
                    result = deepir.run(METHODS[method][0], frames=frames, data={"frames": used.tolist()})
                except DeepIRError as error:
                    yield f"{place} refused: {str(error)[:60]} | | |"
                    continue
                before, after = judged(frames, used, result)
                count += 1
                if before and after and (after.change > before.change or after.detail > before.detail):
                    worse += 1
                    place = place.replace(f"| {method} |", f"| **{method}** |")
                yield f"{place} {said(before, after)} | {given_up(result)} |"
                print(f"{place} {said(before, after)} | {given_up(result)}", flush=True)
    yield f"\n{count} runs; {worse} leave more than uncorrected frames in one of the two."


def simulated() -> Iterator[str]:
    """The pattern that is left of recordings with truth."""
    yield "\n## Simulated recordings\n"
    yield "The pattern that is left and, in brackets, its fine part, in sigmas of the noise of a frame. Maps of "
    yield f"{TAKEN} frames of {CAMERA.n_frames}, applied to all; `true maps`: the gain and the offset's mean.\n"
    yield f"| recording | stored | raw | true maps | {' | '.join(METHODS_OF_SCENES)} | given up by multiview_nuc |"
    yield "|---|---|---|---|" + "---|" * (len(METHODS_OF_SCENES) + 1)
    used = np.linspace(0, CAMERA.n_frames - 1, TAKEN).astype(int)
    for kind in RECORDING_KINDS:
        for name, stored in STORED.items():
            recording = simulate_recording(replace(CAMERA, kind=kind, **stored), seed=SIMULATED_SEED)
            truth = recording.truth
            scales, levels = truth.agc_gain[:, None, None], truth.agc_offset[:, None, None]
            best = (recording.frames - scales * truth.offset.mean(0) - levels) / truth.gain
            row, gone = [left(each, recording) for each in (recording.frames, best)], ""
            for method in METHODS_OF_SCENES:
                problem, *settings = METHODS[method]
                try:
                    result = deepir.run(
                        problem, *settings, frames=recording.frames, data={"frames": used.tolist()}
                    )
                except DeepIRError as error:
                    row.append(f"refused: {str(error)[:60]}")
                    continue
                row.append(left((recording.frames - result.offset) / result.gain, recording))
                gone = given_up(result) if method == "multiview_nuc" else gone
            yield f"| {kind} | {name} | {' | '.join(row)} | {gone} |"


def left(corrected: np.ndarray, recording: Recording) -> str:
    """A cell of a table: root mean squares of what is left, and of its fine part."""
    pattern = np.nan_to_num(residual_map(corrected, recording))
    return f"{pattern.std():.2f} ({fine(pattern).std():.2f})"


def true_pattern(raw: np.ndarray, calibrated: np.ndarray, rounds: int = 12) -> np.ndarray:
    """F of `raw = s calibrated + l + F`, by turns of least squares for s and l and the median over the frames."""
    some = np.arange(0, len(raw), 5)
    pattern = np.zeros(raw.shape[1:])
    for _ in range(rounds):
        rest = []
        for y, x in zip(raw[some], calibrated[some], strict=True):
            slope, level = np.polyfit(x.ravel()[::7], (y - pattern).ravel()[::7], 1)
            rest.append(y - slope * x - level)
        pattern = np.median(rest, axis=0)
    return np.asarray(pattern - pattern.mean())


def fine(pattern: np.ndarray) -> np.ndarray:
    """A pattern less its mean over 5 x 5 px, without its border."""
    return np.asarray((pattern - ndimage.uniform_filter(pattern, 5))[8:-8, 8:-8])


def calibrated_drive() -> tuple[np.ndarray, np.ndarray] | None:
    """The Lynred drive, raw and calibrated by a black body; None if it is not there."""
    folder = DATA / "lynred_car"
    if not folder.is_dir():
        return None
    raw, calibrated = (deepir.read_frames(folder / f"{name}.avi").frames for name in ("raw", "calibrated"))
    return raw, calibrated


def alike(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def detail_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Correlation of the fine detail of two frames, edges left out."""
    both = [each - ndimage.gaussian_filter(each, 1.0) for each in (first, second)]
    flat = np.logical_and(*(np.abs(each) < 6 * np.median(np.abs(each)) for each in both))
    return float(np.corrcoef(both[0][flat], both[1][flat])[0, 1])


if __name__ == "__main__":
    main()
