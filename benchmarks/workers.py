"""Throughput of `deepir compare` with two workers against one: `python benchmarks/workers.py`.

Each repeat runs the same cells with one worker and with two, of one thread each, from the start of the first run to the
end of the last: how long the processes take to start is left out.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
from pathlib import Path

from deepir.sweep.cells import parse_axes
from deepir.sweep.sweep import prepare


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=12)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    ratios = []
    for i in range(options.repeats):
        order = (1, 2) if i % 2 else (2, 1)  # by turns: other work on the machine comes and goes
        found = {workers: throughput(workers, options.cells) for workers in order}
        ratios.append(found[2] / found[1])
        print(f"one worker {found[1]:.3f}, two {found[2]:.3f} runs a second: {ratios[-1]:.2f}", flush=True)
    print(f"median {statistics.median(ratios):.2f}")


def throughput(workers: int, cells: int) -> float:
    """Runs in a second: 5 x 160 x 192, one thread each."""
    seeds = ",".join(map(str, range(cells)))
    fixed, axes = parse_axes(["data.simulate={counts: true}", "threads=1", f"seed={seeds}"])
    with tempfile.TemporaryDirectory() as folder:
        with prepare("nuc", fixed, axes, folder=Path(folder), workers=workers) as sweep:
            sweep.run(lambda cell, error: None, None, ())
        if sweep.errors:
            raise SystemExit(f"failed: {sweep.errors}")
        runs = [cell.folder.path for cell in sweep.cells]
        start = min(json.loads((run / "run.json").read_text())["started"] for run in runs)
        return cells / (max((run / "metrics.json").stat().st_mtime for run in runs) - start)


if __name__ == "__main__":
    main()
