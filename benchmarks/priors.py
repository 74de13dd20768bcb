"""Quality and time of every prior: `make bench-priors`.

Bursts are of two regimes of nuc_regimes.py, half A, and, for super-resolution, of sr.py. A prior's own start is the
scene that it is fitted from, the sensor already known: the result of total variation, or the registered average; a
network that draws all of the scene starts from nothing.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from statistics import median

import numpy as np
import sr
import torch
from nuc_oracle import aligned
from nuc_regimes import REGIMES, SEEDS
from nuc_store import burst
from written import write

import deepir
from deepir.config import load, priors
from deepir.simulate import Simulation

CHOSEN = ("columns U(.5, 1)", "counts")
FRAMES = (3, 5, 10)
#: What stands for the start of a prior: one that draws what is added, before its first iteration.
STARTS = {"tv": "dip_residual", "average": "dip"}
FINE = ((2, 8), (4, 16))  # factor and frames of super-resolution
FINE_PICTURES = ("rocket", "procedural 40")  # not coffee: the denoiser `cnn` has learnt from it
HEADER = (
    "| prior | start | " + " | ".join(f"{n} frames" for n in FRAMES) + " | over TV | over own start | s |"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="how many of the seeds to run")
    parser.add_argument("--prior", action="append", help="only this one")
    parser.add_argument("--published", action="store_true", help="those with published settings too: hours")
    parser.add_argument("--output", type=Path, help="write the table to this file too")
    options = parser.parse_args()
    names = options.prior or [name for name in priors() if options.published or not published(name)]
    seeds = SEEDS["A"][: options.seeds]
    script = f"benchmarks/priors.py, {torch.get_num_threads()} threads, seeds {seeds}"
    lines = chain(report(names, seeds), [""], fine_report(names, sr.SEEDS[: options.seeds]))
    write(lines, script, options.output)


def published(name: str) -> bool:
    """Whether a preset holds published settings."""
    return name.endswith(("_official", "_2021"))


def report(names: Sequence[str], seeds: Sequence[int]) -> Iterator[str]:
    """Lines of markdown: medians over bursts of PSNR in dB, and of seconds."""
    sims = {
        (regime, n, seed): burst(
            REGIMES[regime].picture("A"), REGIMES[regime].settings(n), seed, fresh=False
        )[0]
        for regime in CHOSEN
        for n in FRAMES
        for seed in seeds
    }
    starts = {
        start: {key: quality(sim, prior, "scene.fit.iterations=0")[0] for key, sim in sims.items()}
        for start, prior in STARTS.items()
    }
    reference = {key: quality(sim, "tv")[0] for key, sim in sims.items()}
    yield f"{HEADER}\n|{'---|' * (len(FRAMES) + 5)}"
    for name in ["tv", *(each for each in names if each != "tv")]:
        found = {key: quality(sim, name) for key, sim in sims.items()}
        scene = load("nuc", [f"prior={name}"]).scene
        start = str(scene.get("init", "average")) if scene.get("fit") else ""
        by_frames = [median(found[key][0] for key in found if key[1] == n) for n in FRAMES]
        over = median(found[key][0] - reference[key] for key in found)
        cells = [name, start, *(f"{each:.2f}" for each in by_frames), f"{over:+.2f}"]
        begun = bool(start) and (scene.get("residual") or scene.get("picture") or scene["type"] == "pixels")
        own = median(found[key][0] - starts[start][key] for key in found) if begun else None
        cells += ["from nothing" if start and own is None else "" if own is None else f"{own:+.2f}"]
        yield f"| {' | '.join([*cells, f'{median(s for _, s in found.values()):.1f}'])} |"


def fine_report(names: Sequence[str], seeds: Sequence[int]) -> Iterator[str]:
    """Lines of markdown for super-resolution: medians over pictures and seeds."""
    keys = [(p, factor, n, seed) for factor, n in FINE for p in FINE_PICTURES for seed in seeds]
    sims = {key: sr.burst(*key)[0] for key in keys}
    columns = [f"x{factor}, {n} frames" for factor, n in FINE]
    yield f"| prior | {' | '.join(columns)} | over TV | s |\n|{'---|' * (len(FINE) + 3)}"
    reference: dict[tuple[str, int, int, int], float] = {}
    for name in ["tv", *(each for each in names if each != "tv")]:
        found = {key: finer(sim, name) for key, sim in sims.items()}
        reference = reference or {key: psnr for key, (psnr, _) in found.items()}
        by_factor = [median(found[key][0] for key in keys if key[1] == factor) for factor, _ in FINE]
        over, seconds = (
            median(found[key][0] - reference[key] for key in keys),
            median(s for _, s in found.values()),
        )
        yield f"| {name} | {' | '.join(f'{each:.2f}' for each in by_factor)} | {over:+.2f} | {seconds:.1f} |"


def finer(sim: Simulation, prior: str) -> tuple[float, float]:
    """As `quality`, of super-resolution."""
    return quality(sim, prior, f"physics.downsample.factor={sim.settings.factor}", problem="sr")


def quality(sim: Simulation, prior: str, *more: str, problem: str = "nuc") -> tuple[float, float]:
    """PSNR in dB after one gain and level, and seconds."""
    result = deepir.run(problem, f"prior={prior}", *more, frames=sim.frames)
    return aligned(np.asarray(result.scene, float), sim), result.metrics["seconds"]


if __name__ == "__main__":
    main()
