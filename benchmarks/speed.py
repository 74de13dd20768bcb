"""Seconds and memory of whole commands, from the start of the process to the last file: `make bench-speed`.

Each command runs on simulated data, once to fill caches, and then some times more. The table takes the place of the
one between the comments in docs/benchmarks/overview.md.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

PAGE = Path(__file__).parents[1] / "docs" / "benchmarks" / "overview.md"
MARKS = "<!-- speed -->", "<!-- end of speed -->"
HEADER = "| command | data | s | CPU s | of the solve, s | peak, MB |\n|---|---|---|---|---|---|"
BURST, RECORDING = ("n_frames=5",), ("kind=walk",)
#: Command, data in words, and how they are simulated.
CASES = (
    ("run nuc", "5 x 192 x 160", (*BURST, "shape=[160,192]")),
    ("run nuc", "5 x 640 x 512", (*BURST, "shape=[512,640]")),
    ("run sr", "16 x 160 x 120, x4", ("n_frames=16", "shape=[120,160]")),
    ("correct", "40 x 160 x 120, a walk", (*RECORDING, "n_frames=40", "shape=[120,160]")),
    ("correct", "240 x 320 x 240, a walk", (*RECORDING, "n_frames=240", "shape=[240,320]")),
    ("correct", "600 x 640 x 480, a drive", ("kind=drive", "n_frames=600", "shape=[480,640]")),
)
MEGABYTE = 2**20 if sys.platform == "darwin" else 2**10  # of `ru_maxrss`


class Cost(NamedTuple):
    seconds: float
    cpu: float
    peak: float


def cost(folder: Path, *arguments: str) -> Cost:
    """Of a process of Python that leaves what it writes in a folder."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, *arguments], cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    _, status, used = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"{' '.join(arguments)} failed")
    return Cost(time.perf_counter() - start, used.ru_utime + used.ru_stime, used.ru_maxrss / MEGABYTE)


def rows(folder: Path, repeats: int) -> Iterator[str]:
    """Of the table, medians."""
    yield HEADER
    for command, what, settings in CASES:
        data, run = folder / "data.npz", folder / "run"
        cost(folder, "-m", "deepir", "simulate", str(data), *settings, "--overwrite")
        given = (f"data.path={data}", f"output.dir={run}") if command.startswith("run") else (str(data),)
        costs, solves = [], []
        for _ in range(repeats + 1):
            costs.append(cost(folder, "-m", "deepir", *command.split(), *given, "--overwrite"))
            if command.startswith("run"):
                solves.append(json.loads((run / "metrics.json").read_text(encoding="utf-8"))["seconds"])
        seconds, cpu, peak = (statistics.median(each) for each in zip(*costs[1:], strict=True))
        solve = f"{statistics.median(solves[1:]):.2f}" if solves else ""
        yield f"| `{command}` | {what} | {seconds:.2f} | {cpu:.2f} | {solve} | {peak:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--page", action="store_true", help="write the table into docs/benchmarks/overview.md")
    options = parser.parse_args()
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for line in rows(Path(folder), options.repeats):
            print(line, flush=True)
            lines.append(line)
    if options.page:
        first, last = MARKS
        table = "\n".join([first, *lines, last])
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(re.sub(f"{first}.*{last}", lambda _: table, page, flags=re.DOTALL), encoding="utf-8")


if __name__ == "__main__":
    main()
