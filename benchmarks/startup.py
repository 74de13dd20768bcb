"""Seconds from the start of the process to its end, beside those of the import of torch and of the solve.

    python benchmarks/startup.py

A run is to take at most torch's import and 1.6 times the seconds of its solve.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SIZES = ((160, 192), (512, 640))  # px, height and width
FRAMES = 5
TARGET = 1.6


def seconds(*arguments: str) -> float:
    """Seconds that a process of Python takes."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    start = time.perf_counter()
    subprocess.run([sys.executable, *arguments], env=environment, check=True, capture_output=True)
    return time.perf_counter() - start


def measure(size: tuple[int, int], folder: Path, repeats: int) -> tuple[float, float, float]:
    """Medians: of the import of torch, the solve and the whole run, s."""
    burst, run = folder / "burst.npz", folder / "run"
    deepir = ("-m", "deepir")
    seconds(*deepir, "simulate", str(burst), f"n_frames={FRAMES}", f"shape={list(size)}", "--overwrite")
    rows = []
    for _ in range(repeats + 1):
        whole = seconds(*deepir, "run", "nuc", f"data.path={burst}", f"output.dir={run}", "--overwrite")
        solve = json.loads((run / "metrics.json").read_text(encoding="utf-8"))["seconds"]
        rows.append((seconds("-c", "import torch"), solve, whole))
    torch, solve, whole = (statistics.median(each) for each in zip(*rows[1:], strict=True))  # the first fills caches
    return torch, solve, whole


def main() -> None:
    """Print one row a size."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    print("| frames | torch, s | solve, s | run, s | (run - torch) / solve |\n|---|---|---|---|---|")
    for size in SIZES:
        with tempfile.TemporaryDirectory() as folder:
            torch, solve, whole = measure(size, Path(folder), repeats)
        name = f"{FRAMES} x {size[0]} x {size[1]}"
        print(f"| {name} | {torch:.2f} | {solve:.2f} | {whole:.2f} | {(whole - torch) / solve:.2f} |")
    print(f"\nat most {TARGET} is the aim")


if __name__ == "__main__":
    main()
