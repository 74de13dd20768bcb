"""Quality under stray flux against an oracle, for three priors, and seconds: `make bench-narcissus`.

The oracle is that of nuc_oracle.py, which is given the true stray flux beside sensor, motion and noise: it sees
`g (M x + s) + o` as a sensor of offset `g s + o`. Constants were tuned on other pictures and seeds.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from nuc_oracle import aligned, oracle
from nuc_regimes import CLEAN, COUNTS, UNIT, picture
from nuc_store import kept
from sr import stretch
from written import write

import deepir
from deepir.io import read_frames
from deepir.report.panels import write_panels
from deepir.simulate import Settings, Simulation, simulate

CAMERAS = {"photons": UNIT, "counts": COUNTS | {"read_noise": 0.004, "pedestal": 4000.0}}
SHAPES, STRENGTHS = ("smooth", "radial", "ring", "edge"), (0.2, 1.0, 4.0)
PICTURES = ("coffee", "rocket", "coins", "procedural 40")
SEED = 301
PRIORS = ("foe", "tv", "red", "tgv")
DEFAULT = PRIORS[0]
VIGNETTED = "duo_pro_r_radiometric.tiff"  # counts of 0.04 K
VERSION = 1  # to be raised with a change that gives other oracles
HEADER = (
    f"| camera | stray flux | % | picture | nuc | {' | '.join(PRIORS)} | oracle | gap | left, % | seconds |\n"
    f"|{'---|' * (9 + len(PRIORS))}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fresh", action="store_true", help="take no oracle from runs/bench-nuc")
    parser.add_argument("--threads", type=int, default=2, help="the machine's, for the seconds")
    parser.add_argument(
        "--panels", type=Path, help="write the pictures of docs/explanation/narcissus.md to this folder instead"
    )
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    if options.panels:
        polariser(options.panels)
        if "DEEPIR_DATA" in os.environ:
            vignetting(options.panels)
        return
    write(report(fresh=options.fresh), "benchmarks/narcissus.py", options.output)


def report(*, fresh: bool) -> Iterator[str]:
    """Lines of markdown: a row for each burst, and the gap's mean and worst."""
    yield HEADER
    gaps = []
    for i, (camera, shape, strength) in enumerate(cases()):
        name = PICTURES[i % len(PICTURES)]
        sim = burst(i)
        best = told(sim, picture(name), name, fresh=fresh)
        found = {"nuc": deepir.run("nuc", frames=sim.frames)}
        found |= {prior: deepir.run("narcissus", frames=sim.frames, prior=prior) for prior in PRIORS}
        quality = {each: aligned(result.scene, sim) for each, result in found.items()}
        gaps.append(best - quality[DEFAULT])
        columns = " | ".join(f"{quality[prior]:.1f}" for prior in PRIORS[1:])
        left = left_over(found[DEFAULT], sim)
        yield (
            f"| {camera} | {shape} | {100 * strength:.0f} | {name} | {quality['nuc']:.1f} | "
            f"**{quality[DEFAULT]:.1f}** | {columns} | {best:.1f} | {gaps[-1]:.1f} | {100 * left:.0f} | "
            f"{found[DEFAULT].metrics['seconds']:.1f} |"
        )
    yield f"\nGap to the oracle: mean {np.mean(gaps):.1f} dB, worst {max(gaps):.1f} dB, of {len(gaps)} bursts."


def cases() -> Iterator[tuple[str, str, float]]:
    """Camera, shape and strength (fraction of the scene's range) of each burst."""
    yield from (("photons", shape, strength) for shape in SHAPES for strength in STRENGTHS)
    yield from (("counts", shape, 1.0) for shape in SHAPES)


def burst(i: int) -> Simulation:
    """The burst of the i-th case."""
    camera, shape, strength = list(cases())[i]
    settings = Settings(stray=strength, stray_shape=shape, **(CLEAN | CAMERAS[camera]))
    return simulate(picture(PICTURES[i % len(PICTURES)]), settings, seed=SEED + i)


def left_over(result: deepir.Result, sim: Simulation) -> float:
    """Part of the stray flux that is not found."""
    return float((result.extra["stray"] - sim.truth.stray).std() / sim.truth.stray.std())


def told(sim: Simulation, scene: np.ndarray, name: str, *, fresh: bool) -> float:
    """The oracle's PSNR."""
    truth = sim.truth
    whole = dataclasses.replace(truth, offset=truth.offset + truth.gain * truth.stray)
    total = float(sim.frames.sum(dtype=np.float64))
    key = ["narcissus", name, dataclasses.asdict(sim.settings), sim.seed, total, VERSION]

    def make() -> dict[str, np.ndarray]:
        return {"psnr": np.array(oracle(dataclasses.replace(sim, truth=whole), scene))}

    return float(kept("narcissus-oracles", key, make, fresh=fresh)["psnr"])


def polariser(folder: Path) -> None:
    """The camera's own reflection in a polariser in front of it: a frame, what is found, and the truth."""
    scene = picture("procedural 40")
    camera = CLEAN | UNIT | {"stray": 2.0, "stray_shape": "edge"}
    sim = simulate(scene, Settings(**camera), seed=SEED)
    plain, result = (deepir.run(problem, frames=sim.frames) for problem in ("nuc", "narcissus"))
    print(f"nuc {aligned(plain.scene, sim):.1f} dB, narcissus {aligned(result.scene, sim):.1f} dB")
    panels = [("one frame", sim.frames[0]), ("nuc", plain.scene), ("narcissus: scene", result.scene)]
    panels += [("narcissus: stray", result.extra["stray"]), ("true stray flux", sim.truth.stray)]
    write_panels(folder / "narcissus.png", [(title, each, *stretch(each)) for title, each in panels])


def vignetting(folder: Path) -> None:
    """A frame of a real camera whose corners are dark, before and after, in kelvin."""
    kelvin = 0.04 * read_frames(Path(os.environ["DEEPIR_DATA"]) / "radiometric_jpg" / VIGNETTED).frames
    result = deepir.run("narcissus", frames=kelvin)
    after = kelvin[0] - result.extra["stray"]
    for title, each in (("before", kelvin[0]), ("after", after)):
        corners = [each[y, x] for y in (np.s_[:64], np.s_[-64:]) for x in (np.s_[:64], np.s_[-64:])]
        differences = [float(np.median(corner) - np.median(each)) for corner in corners]
        print(title, ", ".join(f"{each:+.2f} K" for each in differences), f"{each.std():.2f} K in all")
    panels = [("raw frame", kelvin[0]), ("narcissus: scene", result.scene)]
    panels += [("narcissus: stray", result.extra["stray"])]
    write_panels(folder / "narcissus_real.png", [(title, each, *stretch(each)) for title, each in panels])


if __name__ == "__main__":
    main()
