"""Damaged inputs, kills, full disks, flipped bits and races, counted: `make reliability`.

Counts are kept, so that a run that was cut short goes on; those with a failure in them are made again. `--minutes`
bounds the time, and the page says what has been counted until then. Inputs that failed are in runs/reliability.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from cells import Arrays, Cell, done, worked
from reliability_fuzz import ERROR, KINDS, OUTCOMES, READ, count_inputs
from reliability_runs import EVENTS, RUNS, count_runs
from written import write

import deepir

SCRIPT = "benchmarks/reliability.py"
INPUTS, INPUTS_PER_CELL = 1_000_000, 5_000
TRIES_PER_CELL = 10
#: Tries of each part.
TRIES = {"kills": 200, "kills at events": 100, "full disks": 50, "flipped bits": 200, "races": 100}
DAMAGES = {
    "bytes": "one to four bytes are changed",
    "splice": "the start of one file, and the end of another",
    "truncation": "a part is cut off, left out or repeated",
    "fields": "numbers of 16 to 64 bits become zero, all ones, huge, or their own place",
    "digits": "numbers in texts become others",
    "bomb, cycle": "one of 1,000: much data in few bytes, directories or links in a circle",
}
BATCH = 4  # cells of each worker between looks at the clock
CODE = deepir.__version__


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", choices=["inputs", *TRIES], help="count this part only")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="stop counting after this time")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    end = time.monotonic() + 60 * options.minutes
    for part in [options.part] if options.part else ["inputs", *TRIES]:
        kind, measure, cells = _work(part)
        found = done(kind, cells, code=CODE)
        todo = [cell for cell in cells if cell not in found or _failed(part, found[cell])]
        size = BATCH * options.workers
        for batch in (todo[at : at + size] for at in range(0, len(todo), size)):
            if time.monotonic() < end:
                worked(kind, batch, measure, code=CODE, workers=options.workers, fresh=True)
    write(report(), SCRIPT, options.output)


def _work(part: str) -> tuple[str, Callable[..., Arrays], list[Cell]]:
    """What is kept, what counts, and the cells of a part."""
    if part == "inputs":
        starts = range(0, INPUTS, INPUTS_PER_CELL)
        return "inputs", count_inputs, [(start, start + INPUTS_PER_CELL) for start in starts]
    starts = range(0, TRIES[part], TRIES_PER_CELL)
    return "tries", count_runs, [(part, start, start + TRIES_PER_CELL) for start in starts]


def _failed(part: str, arrays: Arrays) -> bool:
    return bool(arrays["counts"][:, ERROR:].any() if part == "inputs" else arrays["failed"].any())


def _total(part: str) -> Arrays:
    """Sums over the cells that have been counted."""
    kind, _, cells = _work(part)
    found = list(done(kind, cells, code=CODE).values())
    return {name: np.sum([each[name] for each in found], axis=0) for name in found[0]} if found else {}


def report() -> Iterator[str]:
    """The page."""
    yield "# Reliability\n"
    yield "Damaged inputs are read, or refused in one line. Interrupted runs go on. `make reliability` counts both.\n"
    yield from _inputs()
    yield from _runs()


def _inputs() -> Iterator[str]:
    total = _total("inputs")
    if not total:
        return
    counts = total["counts"]
    yield f"## Damaged inputs\n\n{counts.sum():,} inputs were read and described, and every second one streamed too."
    yield "A process may take 5 s and 1 GB for each. Inputs come from small whole files. Half of the packed ones are"
    yield f"damaged inside and packed again. After a repair, a cell of {INPUTS_PER_CELL:,} is counted again.\n"
    yield "| damage | what is done |\n|---|---|"
    yield from (f"| {name} | {what} |" for name, what in DAMAGES.items())
    yield ""
    yield f"| kind | {' | '.join(('inputs', *OUTCOMES))} |\n|{'---|' * (len(OUTCOMES) + 2)}"
    for kind, row in zip(("all", *KINDS), (counts.sum(0), *counts), strict=True):
        yield f"| {kind} | {' | '.join(f'{number:,}' for number in (row.sum(), *row))} |"
    share = counts[:, READ].sum() / counts.sum()
    yield f"\n{share:.0%} are read: the damage lies in samples, or in unused parts.\n"


def _runs() -> Iterator[str]:
    totals = {part: _total(part) for part in TRIES}
    if not any(totals.values()):
        return
    yield "## Interrupted runs\n\nWhole processes of `deepir run nuc`, with a small burst.\n"
    yield "| what is done | right outcome | tries | failed |\n|---|---|---|---|"
    for part, total in totals.items():
        if total:
            yield f"| {part} | {RUNS[part].__doc__} | {total['tries'].sum()} | {total['failed'].sum()} |"
    yield f"\nA run is killed at each of its events in turn: {', '.join(EVENTS)}.\n"


if __name__ == "__main__":
    main()
