"""Whole recordings of many kinds, ours and rivals, each judged by what is known of it: `make bench-recordings`.

    python benchmarks/bench_recordings.py --methods correct --families hand-held agc drive --seeds 0 1 --each

Figures are kept: the same command goes on where it was interrupted. A change of the package makes those of its own
methods anew, a change of a rival those of the rivals. Develop on seeds 0 and 1; 2 to 4 are not looked at meanwhile.
"""

from __future__ import annotations

import argparse
import csv
import functools
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cells import EVERYTHING, worked
from nuc_store import PACKAGE, Arrays, code
from recordings_cases import FAMILIES, case_code, load, missing, names
from recordings_methods import METHODS, OURS
from recordings_tables import Row, each, line, summary

import deepir
from deepir.errors import DeepIRError
from deepir.simulate.recording import RecordingSettings, simulate_recording

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "runs" / "bench-recordings" / "figures.csv"
SEEDS = (0, 1, 2, 3, 4)
#: What the figures of methods depend on, beside the recordings.
DEPENDS_ON = {
    "ours": (*EVERYTHING, "../benchmarks/recordings_methods.py"),
    "rivals": (
        "baselines/**/*.py",
        "multiview/pattern.py",
        "../benchmarks/rivals.py",
        "../benchmarks/recordings_methods.py",
    ),
}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(SEEDS))
    parser.add_argument("--cases", default="", help="only recordings whose names hold this")
    parser.add_argument("--workers", type=int, default=1, help="processes, each of one thread")
    parser.add_argument("--again", action="store_true", help="measure anew what is kept")
    parser.add_argument("--each", action="store_true", help="print a line for each recording and method")
    options = parser.parse_args()
    if PACKAGE.parent != ROOT:
        raise SystemExit(f"deepir is imported from {PACKAGE}, not from {ROOT}: set PYTHONPATH={ROOT}")
    rows = []
    digests = {name: code(*patterns) for name, patterns in DEPENDS_ON.items()}
    cases = {family: case_code(family) for family in options.families if not missing(family)}
    for family in options.families:
        if reason := missing(family):
            print(f"{family}: not run: {reason}", file=sys.stderr)
            continue
        seeds = options.seeds if family not in ("real", "corrected") else options.seeds[:1]
        wanted = [(name, seed) for seed in seeds for name in names(family, seed) if options.cases in name]
        keys = {name: cases[family] + digest for name, digest in digests.items()}
        rows += measured(family, wanted, options.methods, keys, options.workers, options.again)
    if options.each:
        print(*each(rows), sep="\n")
    print(*summary(rows), sep="\n")
    write_csv(rows, FIGURES)


def measured(
    family: str,
    wanted: Sequence[tuple[str, int]],
    methods: Sequence[str],
    keys: dict[str, str],
    workers: int,
    again: bool,
) -> list[Row]:
    """A row for each recording and method; what is kept is not measured again."""
    found = {}
    for group, key in keys.items():
        of_group = [each for each in methods if (each in OURS) == (group == "ours")]
        cells = [(family, name, seed, method) for name, seed in wanted for method in of_group]
        found |= worked("recording-figures", cells, measure, code=key, workers=workers, fresh=again)
    cells = [(family, name, seed, method) for method in methods for name, seed in wanted]
    return [row_of(*cell, found[cell]) for cell in cells]


def measure(family: str, name: str, seed: int, method: str) -> Arrays:
    """Figures, seconds, and how it ended."""
    warm_up()
    case = load(family, name, seed)
    begun, begun_cpu = time.perf_counter(), time.process_time()
    try:
        correction = METHODS[method](case.frames, case.apart)
        seconds = {
            "seconds": time.perf_counter() - begun,
            "CPU seconds": time.process_time() - begun_cpu,
        }
        corrected = np.stack([correction.correct(case.frames[k], int(k)) for k in case.judged])
        figures = seconds | case.judge(corrected.astype(np.float32), correction)
        words = {"status": "done", "kept": correction.kept}
    except DeepIRError as error:
        figures, words = {}, {"status": f"refused: {error}", "kept": ""}
    except (
        Exception
    ) as error:  # one failure must not end hours of work: it is counted, and its words are kept
        figures, words = {}, {"status": f"failed: {type(error).__name__}: {error}", "kept": ""}
    arrays = {key: np.asarray(value) for key, value in (figures | words).items()}
    print(line(row_of(family, name, seed, method, arrays)), flush=True)
    return arrays


def row_of(family: str, name: str, seed: int, method: str, arrays: Arrays) -> Row:
    return {
        "family": family,
        "name": name,
        "seed": seed,
        "method": method,
        **{key: value.item() for key, value in arrays.items()},
    }


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
