"""Corrections of real recordings, judged by frames that they did not use: `make bench-real`.

Lynred: a drive, raw and calibrated by a black body; likeness is the median correlation of corrected frames with the
calibrated ones. A65: a drive with a factory's correction; the correlation of the fine detail of frames far apart, which
only a fixed pattern has. The others: what is left along displacements of frames beside the burst. `DEEPIR_DATA` names
the folder of the data (default ../shared/data).
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from scipy import ndimage
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.result import Result
from deepir.validation.held_out_pattern import Judge

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
SKIP = 17  # frames between those that likeness is taken of


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    if not DATA.is_dir():
        raise SystemExit(f"{DATA} is not there: set DEEPIR_DATA to the folder of the data")
    write(report(), "benchmarks/recordings.py", options.output)


def report() -> Iterator[str]:
    """Lines of markdown."""
    yield from drive()
    yield from a65()


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
                left = result.metrics.get("fixed_pattern_left")
                before, after = judged(raw, used, result)
                rows.append(
                    f"| {method} | {start}::{step} x {count} | {likeness:.3f} | {found[method][-1][1]:.3f} | "
                    f"{before:.3g} | {after:.3g} | {given_up(result)} |"
                )
                print(rows[-1], left, flush=True)
        columns = [
            f"{np.median([a for a, _ in each]):.3f} ({min(a for a, _ in each):.2f}), "
            f"{np.median([b for _, b in each]):.3f}"
            if each
            else ""
            for each in found.values()
        ]
        yield f"| {name} | {like(lambda f: f):.2f} | {like(lambda f: f - truth):.3f} | {' | '.join(columns)} |"
    yield "\nEach run: what is left along the displacements of frames beside the burst, before and after.\n"
    yield "| method | frames | likeness | fine | before | after | given up |\n|---|---|---|---|---|---|---|"
    yield from rows


def judged(frames: np.ndarray, used: np.ndarray, result: Result) -> tuple[float, float]:
    """What raw and corrected frames beside the burst leave along their displacements."""
    beside = np.setdiff1d(np.arange(used[0] + 1, min(used[-1] + 10, len(frames) - 4)), used)[::3][:12]
    pairs = np.stack((beside, np.minimum(beside + 4, len(frames) - 1)), 1)
    some = frames[pairs.ravel()]
    judge = Judge(
        some,
        np.ones(some.shape, bool),
        [(2 * k, 2 * k + 1) for k in range(len(beside))],
        [(result.gain, result.offset)],
    )
    left = judge.left(result.gain, result.offset)
    raw = judge.left(np.ones_like(result.gain), np.zeros_like(result.offset))
    return (np.nan, np.nan) if left is None or raw is None else (raw.change, left.change)


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


def alike(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def detail_correlation(first: np.ndarray, second: np.ndarray) -> float:
    """Correlation of the fine detail of two frames, edges left out."""
    both = [each - ndimage.gaussian_filter(each, 1.0) for each in (first, second)]
    flat = np.logical_and(*(np.abs(each) < 6 * np.median(np.abs(each)) for each in both))
    return float(np.corrcoef(both[0][flat], both[1][flat])[0, 1])


if __name__ == "__main__":
    main()
