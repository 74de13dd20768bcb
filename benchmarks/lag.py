"""Thermal lag: the time constant, and the scene against one for which the lag is ignored: `make bench-lag`.

The rival is `nuc`, which takes the frames for what the camera saw when they were read. The oracle is that of
nuc_oracle.py: total variation that is given the true time constant, sensor, motion and noise, and the weight that is
best on the truth. Constants were tuned on other pictures and seeds.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np
import torch
from nuc_oracle import aligned, oracle
from nuc_regimes import picture
from nuc_store import kept
from written import write

import deepir
from deepir.report.panels import write_panels
from deepir.simulate import Settings, Simulation, simulate

PICTURES = ("coffee", "rocket", "procedural 40")
TAUS, FRAMES = (8.0, 10.0, 12.0), (5, 10)
SEED = 301
PRIORS = ("tv", "hessian", "red")
DETAIL = np.s_[50:110, 40:120]  # of the picture that is drawn
VERSION = 1  # to be raised with a change that gives other oracles
HEADER = (
    "| picture | tau, ms | n | px a frame | one frame | lag ignored | tv | hessian | red | oracle | tau found, ms | "
    "error | seconds |\n|---|---|---|---|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fresh", action="store_true", help="take no oracle from runs/bench-nuc")
    parser.add_argument("--picture", action="append", choices=PICTURES, help="only this one")
    parser.add_argument("--threads", type=int, default=2, help="the machine's, for the seconds")
    parser.add_argument("--panels", type=Path, help="write a picture of the last burst here")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    write(report(options), "benchmarks/lag.py", options.output)


def report(options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: a row for each burst, and what they have in common."""
    yield HEADER
    gains, errors = [], []
    for name, tau, n in product(options.picture or PICTURES, TAUS, FRAMES):
        sim, scene = burst(name, tau, n)
        key = [name, tau, n, SEED, float(sim.frames.sum(dtype=np.float64)), VERSION]

        def make(sim: Simulation = sim, scene: np.ndarray = scene) -> dict[str, np.ndarray]:
            return {"psnr": np.array(oracle(sim, scene))}

        best = float(kept("lag-oracles", key, make, fresh=options.fresh)["psnr"])
        found = {prior: deepir.run("deblur_lag", frames=sim.frames, prior=prior) for prior in PRIORS}
        quality = {prior: aligned(result.scene, sim) for prior, result in found.items()}
        rival = deepir.run("nuc", frames=sim.frames)
        ignored = aligned(rival.scene, sim)
        constant = float(found["tv"].extra["tau"].mean())
        if options.panels:
            draw(options.panels, sim, rival.scene, found["tv"].scene)
        gains.append(quality["tv"] - ignored)
        errors.append(100 * (constant / tau - 1))
        yield (
            f"| {name} | {tau:g} | {n} | {speed(sim):.1f} | {aligned(sim.frames[0], sim):.1f} | {ignored:.1f} | "
            + " | ".join(f"{quality[prior]:.1f}" for prior in PRIORS)
            + f" | {best:.1f} | {constant:.2f} | {errors[-1]:+.1f} % | {found['tv'].metrics['seconds']:.1f} |"
        )
    yield ""
    yield (
        f"Above ignoring the lag: {min(gains):.1f} dB or more, median {statistics.median(gains):.1f}. "
        f"Time constant: within {max(map(abs, errors)):.1f} %, median {statistics.median(map(abs, errors)):.1f}."
    )


def draw(path: Path, sim: Simulation, ignored: np.ndarray, found: np.ndarray) -> None:
    """A picture of a detail: the frame before which the camera moved fastest, both scenes and the true one."""
    way = np.linalg.norm(np.diff(sim.truth.motion[:, :2, 2], axis=0), axis=1)
    frame = sim.frames[1 + int(way.argmax())].astype(float)
    pictures = {"one frame": frame, "lag ignored": ignored, "deepir": found, "truth": sim.truth.scene}
    details = {title: each[DETAIL] for title, each in pictures.items()}
    write_panels(path, [(title, each, *np.percentile(each, [0.5, 99.5])) for title, each in details.items()])


def burst(name: str, tau: float, n: int) -> tuple[Simulation, np.ndarray]:
    """Frames of 120 x 160 px in counts, 60 a second, of a camera that moves up to 6 px; and the picture."""
    settings = Settings(
        n_frames=n, shape=(120, 160), tau=tau, fps=60.0, substeps=16, max_shift=6.0, max_rotation=0.5, counts=True,
        shading=0.0, dead_pixels=0.0,
    )  # fmt: skip
    scene = picture(name)
    return simulate(scene, settings, seed=SEED), scene


def speed(sim: Simulation) -> float:
    """Mean way from one frame to the next, px."""
    return float(np.linalg.norm(np.diff(sim.truth.motion[:, :2, 2], axis=0), axis=1).mean())


if __name__ == "__main__":
    main()
