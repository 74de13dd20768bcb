"""Frames of different scenes: how well pattern and scenes are found, with several priors: `make bench-multiview`.

Ten pictures that nothing was tuned on, a frame of each, and one pattern: 3 % of the range at each pixel, 2 % at each
column and each row. What a prior changes is the scenes: the sensor is found from the gradients, whatever the prior.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage
from written import write

import deepir
from deepir.metrics import scores
from deepir.report.panels import write_panels
from deepir.result import Result
from deepir.simulate import Settings, Simulation, simulate
from deepir.simulate.scenes.procedural import load_picture

PICTURES = "coffee,rocket,coins,brick,chelsea,clock,cell,retina,immunohistochemistry,stereo_motorcycle"
SEEDS = (101, 102, 103)
OFFSETS = {"offset_pixel": 0.03, "offset_column": 0.02, "offset_row": 0.02, "gain_pixel": 0.0, "gain_column": 0.0}
#: What is changed of a burst whose sensor has offsets only and no bad pixels.
BURSTS = {
    "offsets of 3, 2 and 2 %": OFFSETS,
    "the same, 5 frames": OFFSETS | {"n_frames": 5},
    "the same, noise of 2 %": OFFSETS | {"read_noise": 0.02},
    "counts: gain and offset, dead pixels": {"counts": True, "dead_pixels": 0.002},
}
HEADER = (
    "| burst | pattern | gain | one frame | multiview_tv | tv | red | tgv | s |\n|---|---|---|---|---|---|---|---|---|"
)
PRIORS = ("tv", "red", "tgv")
CROP = np.s_[:, 20:400, 60:580]  # of the vehicle's frames, without its bonnet
REACHES = (2, 4, 8)  # px
SKY = np.s_[:190, 120:500]  # of that the part without near things, which parallax moves


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, default=2, help="the machine's, for the seconds")
    parser.add_argument("--panels", type=Path, help="write a picture of a burst here")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    write(report(options.panels), "benchmarks/multiview.py", options.output)


def report(panels: Path | None) -> Iterator[str]:
    """Lines of markdown: correlations with the true pattern and gain, and PSNR of the scenes; medians of the seeds."""
    yield HEADER
    for name, more in BURSTS.items():
        rows = []
        for seed in SEEDS:
            sim = burst(more, seed)
            found = {prior: deepir.run("multiview_nuc", frames=sim.frames, prior=prior) for prior in PRIORS}
            rival = deepir.run("multiview_nuc", frames=sim.frames, method="multiview_tv")
            rows.append(
                [
                    *likeness(found["tv"], sim),
                    quality(sim.frames, sim),
                    quality(rival.scene, sim),
                    *(quality(each.scene, sim) for each in found.values()),
                    found["tv"].metrics["seconds"],
                ]
            )
            if panels and name == next(iter(BURSTS)) and seed == SEEDS[0]:
                draw(panels, sim, found["tv"])
        pattern, gain, *psnr, seconds = np.median(rows, axis=0)
        shown = "" if np.isnan(gain) else f"{gain:.3f}"
        yield f"| {name} | **{pattern:.3f}** | {shown} | {' | '.join(f'{p:.1f}' for p in psnr)} | {seconds:.1f} |"
    if "DEEPIR_DATA" in os.environ:
        yield from vehicle()


def burst(more: dict[str, float | bool], seed: int) -> Simulation:
    """Frames of 160 x 192 px, one of each picture."""
    settings = {"n_frames": 10, "shape": (160, 192), "shading": 0.0, "dead_pixels": 0.0, "own_scenes": True} | more
    return simulate(load_picture(PICTURES), Settings(**settings), seed=seed)


def likeness(result: Result, sim: Simulation) -> tuple[float, float]:
    """Correlation of the pattern at the frames' level, and of the gain, with the truth; over good pixels."""
    good, level = ~sim.truth.bad_pixels, sim.frames.mean()
    patterns = [(each.gain * level + each.offset)[good] for each in (result, sim.truth)]
    gains = [each.gain[good] for each in (result, sim.truth)]
    flat = gains[1].std() == 0
    return correlation(*patterns), float("nan") if flat else correlation(*gains)


def quality(scenes: np.ndarray, sim: Simulation) -> float:
    """PSNR in dB after one gain and level."""
    return scores(scenes, np.where(sim.truth.bad_pixels, np.nan, sim.truth.scene))["psnr_aligned"]


def vehicle() -> Iterator[str]:
    """Ten frames in a row of a camera that moves 15 px in all: the pattern, to those of two registered solutions."""
    frames = np.load(Path(os.environ["DEEPIR_DATA"]) / "a65" / "a65_frames_000-009.npz")["frames"][CROP]
    level = ndimage.gaussian_filter(frames.mean(0, dtype=np.float64), 3)

    def pattern(problem: str, *options: str, every: int = 1) -> np.ndarray:
        result = deepir.run(problem, *options, frames=frames[::every])
        return np.asarray((result.gain - 1) * level + result.offset)

    alone, some = pattern("multiview_nuc"), pattern("multiview_nuc", every=3)
    affine, dense = pattern("nuc", "physics.warp.motion=affine"), pattern("flow")
    pairs = {
        "`multiview_nuc`, `nuc`": (alone, affine),
        "`multiview_nuc`, `flow`": (alone, dense),
        "`nuc`, `flow`": (affine, dense),
        "`multiview_nuc` of frames 0, 3, 6, 9, `nuc`": (some, affine),
    }
    yield "\nA65: correlation of patterns less what is slower than so many px (Gaussian); above the road."
    yield f"\n| patterns | {' | '.join(f'{reach} px' for reach in REACHES)} |\n|{'---|' * (1 + len(REACHES))}"
    for name, both in pairs.items():
        cells = []
        for reach in REACHES:
            first, second = (each - ndimage.gaussian_filter(each, reach) for each in both)
            cells.append(f"{correlation(first, second):.2f}; {correlation(first[SKY], second[SKY]):.2f}")
        yield f"| {name} | {' | '.join(cells)} |"


def correlation(first: np.ndarray, second: np.ndarray) -> float:
    return float(np.corrcoef(first.ravel(), second.ravel())[0, 1])


def draw(path: Path, sim: Simulation, result: Result) -> None:
    """A frame, its scene, and the patterns."""
    low, high = np.percentile(sim.truth.scene[0], [0.5, 99.5])
    reach = 3 * float(sim.truth.offset.std())
    panels = [("one of ten frames", sim.frames[0], low, high), ("its scene, as found", result.scene[0], low, high)]
    panels += [("pattern, as found", result.offset, -reach, reach), ("true pattern", sim.truth.offset, -reach, reach)]
    write_panels(path, panels)


if __name__ == "__main__":
    main()
