"""Whole recordings of many kinds, ours and rivals, each judged by what is known of it: `make bench-recordings`.

    python benchmarks/bench_recordings.py --methods correct --families hand-held agc drive --seeds 0 1 --each

Figures are kept: the same command goes on where it was interrupted. A change of the package makes those of its own
methods anew, a change of a rival those of the rivals. Develop on seeds 0 and 1; 2 to 4 are not looked at meanwhile.
"""

from __future__ import annotations

import argparse
import csv
import functools
import hashlib
import sys
import time
import types
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import recordings_drawn
import recordings_large
import recordings_real
import recordings_simulated
from cells import EVERYTHING, Cell, done, worked
from nuc_store import PACKAGE, Arrays, code
from recordings_cases import DRAWN, Case
from recordings_methods import METHODS, OURS
from recordings_tables import Row, line, page, summary
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.simulate.recording import RecordingSettings, simulate_recording

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "benchmarks" / "recordings.md"
FIGURES = ROOT / "runs" / "bench-recordings" / "figures.csv"
KIND = "recording-figures"  # under which figures are kept
SEEDS = (0, 1, 2, 3, 4)
#: The module that makes the recordings of each family.
FAMILIES: dict[str, types.ModuleType] = {
    family: module
    for module in (recordings_drawn, recordings_large, recordings_simulated, recordings_real)
    for family in module.FAMILIES
}
#: What the figures of ours and of rivals depend on, beside the recordings.
OF_BOTH = ("../benchmarks/recordings_methods.py", "../benchmarks/recordings_scores.py")
DEPENDS_ON = {
    True: (*EVERYTHING, *OF_BOTH),
    False: ("baselines/**/*.py", "multiview/pattern.py", "../benchmarks/rivals.py", *OF_BOTH),
}


def main() -> None:
    options = parsed()
    if PACKAGE.parent != ROOT:
        raise SystemExit(f"deepir is imported from {PACKAGE}, not from {ROOT}: set PYTHONPATH={ROOT}")
    keys = {
        (family, ours): code(*patterns, *(f"../benchmarks/{name}" for name in module.CODE)) + drawn_code()
        for family, module in FAMILIES.items()
        for ours, patterns in DEPENDS_ON.items()
    }  # before anything is measured: files may change meanwhile
    rows: list[Row] = []
    for family in options.families:
        module = FAMILIES[family]
        if reason := module.missing(family):
            print(f"{family}: not run: {reason}", file=sys.stderr)
            continue
        seeds = options.seeds if module is not recordings_real else SEEDS[:1]
        wanted = [(name, seed) for seed in seeds for name in module.names(family, seed) if options.cases in name]
        found: dict[Cell, Arrays] = {}
        cells = [(family, name, seed, method) for method in options.methods for name, seed in wanted]
        for ours in DEPENDS_ON:
            some = sorted(
                (cell for cell in cells if (cell[3] in OURS) == ours), key=lambda cell: wanted.index(cell[1:3])
            )  # a recording is made once for all methods
            key = keys[family, ours]
            if options.kept:
                found |= done(KIND, some, code=key)
            else:
                found |= worked(KIND, some, measure, code=key, workers=options.workers, fresh=options.again)
        rows += [row_of(cell, found[cell]) for cell in cells if cell in found]
    write_csv(rows, FIGURES)
    if options.each:
        print(*map(line, rows), sep="\n")
    if options.page:
        write(page(rows), "benchmarks/bench_recordings.py", PAGE)
    else:
        print(*summary(rows), sep="\n")


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--cases", default="", help="only recordings whose names hold this")
    parser.add_argument("--workers", type=int, default=1, help="processes, each of one thread")
    parser.add_argument("--again", action="store_true", help="measure anew what is kept")
    parser.add_argument("--kept", action="store_true", help="run nothing: tables of what is kept")
    parser.add_argument("--each", action="store_true", help="print a line for each recording and method")
    parser.add_argument("--page", action="store_true", help=f"write {PAGE.relative_to(ROOT)}")
    return parser.parse_args()


def drawn_code() -> str:
    """Digest of the file that draws recordings, which is no part of the project."""
    return hashlib.sha256(DRAWN.read_bytes()).hexdigest()[:24] if DRAWN.exists() else ""


@functools.lru_cache(1)
def load(family: str, name: str, seed: int) -> Case:
    return FAMILIES[family].load(family, name, seed)


def measure(family: str, name: str, seed: int, method: str) -> Arrays:
    """Figures, seconds, and how it ended."""
    warm_up()
    case = load(family, name, seed)
    begun, begun_cpu = time.perf_counter(), time.process_time()
    try:
        correction = METHODS[method](case.frames, case.apart)
        seconds = {"seconds": time.perf_counter() - begun, "CPU seconds": time.process_time() - begun_cpu}
        corrected = np.stack([correction.correct(case.frames[k], int(k)) for k in case.judged])
        figures = seconds | case.judge(corrected.astype(np.float32), correction)
        words = {"status": "done", "kept": correction.kept}
    except DeepIRError as error:
        figures, words = {}, {"status": f"refused: {error}", "kept": ""}
    except Exception as error:  # one failure must not end hours of work: it is counted, and its words are kept
        figures, words = {}, {"status": f"failed: {type(error).__name__}: {error}", "kept": ""}
    arrays = {key: np.asarray(value) for key, value in (figures | words).items()}
    print(line(row_of((family, name, seed, method), arrays)), flush=True)
    return arrays


def row_of(cell: Cell, arrays: Arrays) -> Row:
    keys = ("family", "name", "seed", "method")
    return dict(zip(keys, cell, strict=True)) | {key: value.item() for key, value in arrays.items()}


@functools.cache
def warm_up() -> None:
    """Compiled loops are loaded: no recording's seconds are to be those of a compiler."""
    small = simulate_recording(RecordingSettings(kind="walk", n_frames=40, shape=(96, 128)))
    deepir.correct(small.frames)
    deepir.run("nuc", frames=small.frames, data={"frames": [0, 4, 8, 12, 16]})


def write_csv(rows: Sequence[Row], path: Path) -> None:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
