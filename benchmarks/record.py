"""The benchmark of record: `make bench` a part of it, `make bench-full` all, both through `deepir compare`.

Bursts and results are kept in runs/bench: the same command again runs what is missing, and writes the page anew. What
a cell depends on is recorded beside its results, as for every run.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from record_protocol import Group, Protocol
from record_protocols import protocols

import deepir
from deepir.cli.terminal import Interrupted, Interruptible
from deepir.registry import load_plugin
from deepir.simulate import Settings, simulate
from deepir.sweep.cells import BURST_AXIS, Axis, Cell
from deepir.sweep.sweep import Sweep, prepare

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "runs" / "bench"
PAGE = ROOT / "notes" / "benchmark-of-record.md"
SUMMARY = ROOT / "docs" / "benchmarks" / "record.md"
IMAGES = ROOT / "docs" / "images"
PLUGINS = ("record_methods", "record_deepinv")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="all cells; without it, those of `make bench`")
    parser.add_argument("--workers", type=int, default=2, help="processes, each of one thread")
    parser.add_argument("--protocol", action="append", help="only this one: a, b, sr2 ... (the page is not written)")
    parser.add_argument("--page", action="store_true", help="run nothing: write the page of what is there")
    options = parser.parse_args()
    for each in PLUGINS:
        load_plugin(each)
    chosen = [each for each in protocols() if not options.protocol or each.key in options.protocol]
    found = {each.key: sweeps(each, full=options.full) for each in chosen}
    status = 0
    if not options.page:
        whole = Sweep(FOLDER, [cell for each in found.values() for cell in each], options.workers)
        status = run(whole)
    if not options.protocol:
        from record_page import write_pages

        write_pages(PAGE, SUMMARY, IMAGES, chosen, found, errors(), full=options.full)
    return status


def sweeps(protocol: Protocol, *, full: bool) -> list[Cell]:
    """The cells of a protocol; its bursts are written where they are missing."""
    groups = [each for each in protocol.groups if full or not each.full]
    return [cell for group in groups for cell in cells(protocol, group)]


def cells(protocol: Protocol, group: Group) -> list[Cell]:
    """The cells of a group whose bursts are to be had."""
    folder = FOLDER / protocol.key
    found = []
    for burst in group.bursts:
        if protocol.bursts[burst].missing():
            continue
        stem = FOLDER / "bursts" / f"{protocol.key}-{burst}"
        axes = [
            Axis("method", {k: [each.replace("STEM", str(stem)) for each in v] for k, v in group.methods.items()}),
            Axis("data.frames", {str(n): [f"data.frames={n}"] for n in group.frames}),
            Axis(BURST_AXIS, {burst: protocol.bursts[burst].written(stem)}),
        ]
        with prepare(group.config, ["threads=1"], axes, folder=folder) as sweep:
            found += sweep.cells
    return found


def run(sweep: Sweep) -> int:
    """Finish the cells, and keep what went wrong; the exit status."""
    if todo := len(sweep.unfinished()):
        compile_loops()
    start, done = time.monotonic(), 0
    print(f"{todo} of {len(sweep.cells)} runs are to be done", file=sys.stderr, flush=True)

    def say(cell: Cell, error: str | None) -> None:
        nonlocal done
        done += 1
        where = f"{cell.folder.path.parent.name}/{cell.name}"
        end = f": {error}" if error else ""
        print(f"{time.monotonic() - start:6.0f} s  {done}/{todo}  {where}{end}", file=sys.stderr, flush=True)
        note(where, error)

    try:
        with Interruptible():
            sweep.run(say, None, PLUGINS)
    except Interrupted as error:
        print("interrupted; the same command goes on with what is missing", file=sys.stderr)
        return error.status
    return 0


def compile_loops() -> None:
    """Once for a machine: no cell's seconds are to be those of a compiler."""
    deepir.run("nuc", frames=simulate(settings=Settings(shape=(48, 56), max_shift=4.0)).frames, threads=1)


def errors() -> dict[str, str]:
    """What went wrong with cells that are not finished, by protocol and name."""
    path = FOLDER / "errors.json"
    return json.loads(path.read_text()) if path.exists() else {}


def note(where: str, error: str | None) -> None:
    """Keep an error, or forget it."""
    known = errors()
    if known.pop(where, None) != error or error:
        known |= {where: error} if error else {}
        (FOLDER / "errors.json").write_text(json.dumps(known, indent=1, sort_keys=True))


if __name__ == "__main__":
    raise SystemExit(main())
