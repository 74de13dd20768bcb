"""How time and memory grow with the burst; each run in a fresh process."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepir.simulate import Settings, simulate

BASE, FRAMES_AT = (160, 192), (256, 320)
PIXELS = {1: BASE, 2: (226, 272), 4: (320, 384), 8: (452, 544)}  # 2 and 8: to 0.1 %
FRAMES = {1: 5, 2: 10, 4: 20}
LARGE = (20, (1024, 1280), 1)  # frames, shape, runs of which the median is taken
CODE = """
import sys, numpy, deepir
from deepir.kernels.memory import peak_memory
import deepir.pipeline.reconstruct, deepir.problems.nuc, deepir.registration
frames = numpy.load(sys.argv[1])
before = peak_memory()
found = deepir.run("nuc", frames=frames).metrics
print(found["seconds"], found["evaluations"], found["peak_memory_mb"], found["peak_memory_mb"] - before)
"""


def growth(*, large: bool) -> Iterator[str]:
    """Tables in lines of markdown."""
    yield "| burst | seconds | evaluations | peak memory, MB | of which the burst's |\n|---|---|---|---|---|"
    found = {}
    for n, shape in [(5, shape) for shape in PIXELS.values()] + [(n, FRAMES_AT) for n in FRAMES.values()]:
        found[n, shape] = measure(n, shape)
        yield row(n, shape, found[n, shape])
    yield row(5, (512, 640), measure(5, (512, 640)))
    if large:
        n, shape, runs = LARGE
        yield row(n, shape, measure(n, shape, runs))
    by_pixels = [found[5, shape] for shape in PIXELS.values()]
    by_frames = [found[n, FRAMES_AT] for n in FRAMES.values()]
    yield "\nExponents of growth, fitted to the rows (1: in proportion):\n"
    yield "| with | time | memory |\n|---|---|---|"
    for name, steps, rows in (("pixels, 1 to 8 x", PIXELS, by_pixels), ("frames, 1 to 4 x", FRAMES, by_frames)):
        time, memory = (exponent(list(steps), [each[i] for each in rows]) for i in (0, 3))
        yield f"| {name} | {time:.2f} | {memory:.2f} |"


def measure(n: int, shape: tuple[int, int], runs: int = 3) -> list[float]:
    """Seconds, evaluations, peak memory and its rise over the start, in MB: the run of median time."""
    camera = Settings(n_frames=n, shape=shape, counts=True, shading=0.0, dead_pixels=0.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frames.npy"
        np.save(path, simulate(None, camera, seed=200).frames)
        command = [sys.executable, "-c", CODE, str(path)]
        out = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(runs)]
    return sorted([float(word) for word in each.split()] for each in out)[runs // 2]


def exponent(steps: list[int], values: list[float]) -> float:
    """Slope in a doubly logarithmic plot."""
    return float(np.polyfit(np.log(steps), np.log(values), 1)[0])


def row(n: int, shape: tuple[int, int], found: list[float]) -> str:
    """A line of the table."""
    seconds, evaluations, peak, rise = found
    return f"| {n} x {shape[1]} x {shape[0]} | {seconds:.2f} | {evaluations:.0f} | {peak:.0f} | {rise:.0f} |"
