"""Quality of super-resolution against an oracle, and seconds: `make bench-sr`.

The oracle is that of nuc_oracle.py: total variation that is given the true sensor, motion and noise, and the weight
that is best on the truth. Constants were tuned on other pictures and seeds.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from nuc_oracle import aligned, oracle
from nuc_regimes import picture
from nuc_store import kept
from paper import picture as of_paper
from written import write

import deepir
from deepir.report.panels import write_panels
from deepir.simulate import Settings, Simulation, simulate

PICTURES = ("coffee", "rocket", "procedural 40")
SEEDS = (301,)
FACTORS, FRAMES = (2, 4), (4, 8, 16)
ROWS, COLUMNS = slice(150, 406), slice(130, 450)  # of the thermal picture: the part that frame 0 shows
VERSION = 1  # to be raised with a change that gives other oracles
HEADER = (
    "| picture | factor | n | bicubic | average, cubic | deepir | oracle | gap | seconds |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prior", default="tv", help="of the scene")
    parser.add_argument("--fresh", action="store_true", help="take no oracle from runs/bench-nuc")
    parser.add_argument("--picture", action="append", help="only this one; 'thermal' needs DEEPIR_DATA")
    parser.add_argument("--threads", type=int, default=2, help="the machine's, for the seconds")
    parser.add_argument("--panels", type=Path, help="write a picture of the thermal burst here")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    write(report(options), "benchmarks/sr.py", options.output)


def report(options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: a row for each burst."""
    yield HEADER
    for name, factor, n, seed in cases(options.picture):
        sim, scene = burst(name, factor, n, seed)
        key = [name, factor, n, seed, float(sim.frames.sum(dtype=np.float64)), VERSION]

        def make(sim: Simulation = sim, scene: np.ndarray = scene) -> dict[str, np.ndarray]:
            return {"psnr": np.array(oracle(sim, scene))}

        best = float(kept("sr-oracles", key, make, fresh=options.fresh)["psnr"])
        found = {
            method: deepir.run(
                "sr", f"physics.downsample.factor={factor}", frames=sim.frames, method=method, prior=options.prior
            )
            for method in ("bicubic", "average", "joint")
        }
        quality = {method: aligned(result.scene, sim) for method, result in found.items()}
        yield (
            f"| {name} | {factor} | {n} | {quality['bicubic']:.1f} | {quality['average']:.1f} | "
            f"**{quality['joint']:.1f}** | {best:.1f} | {best - quality['joint']:.1f} | "
            f"{found['joint'].metrics['seconds']:.1f} |"
        )
        if name == "thermal" and options.panels:
            panels = [("one frame", sim.frames[0]), ("bicubic", found["bicubic"].scene)]
            panels += [("deepir", found["joint"].scene), ("truth", sim.truth.scene)]
            write_panels(options.panels, [(title, each, *stretch(each)) for title, each in panels])


def cases(pictures: list[str] | None) -> Iterator[tuple[str, int, int, int]]:
    """Picture, factor, frames and seed of each burst; the thermal picture's where the data are at hand."""
    for name in pictures or PICTURES:
        if name != "thermal":
            yield from ((name, factor, n, seed) for factor in FACTORS for n in FRAMES for seed in SEEDS)
    if "DEEPIR_DATA" in os.environ and (not pictures or "thermal" in pictures):
        yield from (("thermal", 4, 16, seed) for seed in (0, 1, 2))


def burst(
    name: str, factor: int, n: int, seed: int, *, shape: tuple[int, int] = (64, 80), max_shift: float = 10.0
) -> tuple[Simulation, np.ndarray]:
    """Frames, of columns of the gain U(.5, 1) and 1,000 photons; and the picture."""
    settings = Settings(
        n_frames=n, shape=shape, factor=factor, motion="shift", max_shift=max_shift, gain_distribution="uniform",
        gain_column=0.5, gain_pixel=0.0, offset_pixel=0.0, offset_column=0.0, offset_row=0.0, shading=0.0,
        photons=1000.0, read_noise=0.002, dead_pixels=0.0, psf_sigma=0.0,
        scale=float(factor) if name == "thermal" else None,
    )  # fmt: skip
    scene = thermal() if name == "thermal" else picture(name)
    return simulate(scene, settings, seed=seed), scene


def thermal() -> np.ndarray:
    """The 2021 paper's `test1.png` in [0, 1], cut so that the part in question is in its middle."""
    grey = of_paper()
    sides = zip((ROWS, COLUMNS), grey.shape, strict=True)
    margins = (min(part.start, side - part.stop) for part, side in sides)
    parts = zip((ROWS, COLUMNS), margins, strict=True)
    y, x = (slice(part.start - margin, part.stop + margin) for part, margin in parts)
    return grey[y, x]


def stretch(image: np.ndarray) -> tuple[float, float]:
    """Values of black and white."""
    low, high = np.percentile(image, [0.5, 99.5])
    return float(low), float(high)


if __name__ == "__main__":
    main()
