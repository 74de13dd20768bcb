"""The 2021 formulation on the protocol of its paper, and every prior of ours on the same bursts: `make bench-paper`.

A frame is `Poisson(tau G R_k X)`, X a part of the paper's `test1.png`, columns of the gain U(v, 1), tau 1,000 photons,
shifts up to 10 px: as its code simulates them, on the picture's own grid, and frame 0 not moved. `DEEPIR_DATA` names
the folder that has the picture. `paper/nuc` takes minutes a burst; its figures are kept until `VERSION` is raised.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from statistics import median

import numpy as np
from cells import EVERYTHING, Arrays, Cell, done, worked
from nuc_store import code
from scipy.ndimage import map_coordinates
from skimage.io import imread
from written import write

import deepir
from deepir.config import prior_names
from deepir.metrics import scores

ROWS, COLUMNS = slice(150, 310), slice(130, 322)
SEEDS = (0, 1, 2)
SHIFT, PHOTONS = 10.0, 1000.0  # px, and in one unit of the picture
#: Frames, least gain of a column in %, largest rotation in degrees -> PSNR in dB that the paper's own code reached.
PROTOCOLS = {(3, 50, 0): 28.5, (5, 50, 0): 34.3, (3, 80, 6): 33.1, (5, 80, 6): 35.7}
VERSION = 3  # to be raised with a change that gives other figures of `paper/nuc`
PAPER = "paper/nuc"
EXPLAINED = """# On the 2021 paper's protocol

Medians over seeds of PSNR in dB, after one gain and level, with a peak of one as the paper has it; seconds of one
thread. A frame is `Poisson(1000 G R_k X)`: 160 x 192 px of the paper's `test1.png`, columns of the gain in U(v, 1),
shifts up to 10 px, and rotations. "Over `paper/nuc`": the median over bursts of the difference. The paper's own code
was measured on another such burst, and after a warp of its result onto the truth.
[Priors](../docs/explanation/priors.md#the-2021-formulation) says what `paper/nuc` is.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prior", action="append", help="only this one of ours")
    parser.add_argument("--frames", type=int, action="append", help="only bursts of so many")
    parser.add_argument("--seed", type=int, action="append", help="only these")
    parser.add_argument("--float32", action="store_true", help="paper/nuc not in bfloat16: twice as long")
    parser.add_argument("--finished", action="store_true", help="run nothing: the table of what is kept")
    parser.add_argument("--workers", type=int, default=1, help="processes of one thread each")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    write(report(options), "benchmarks/paper.py", options.output)


def report(options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: medians over seeds of PSNR in dB, and of seconds."""
    paper = PAPER if options.float32 else f"{PAPER} scene.bf16=true"
    ours = [f"nuc prior={name}" for name in options.prior or unpublished()]
    seeds = options.seed or SEEDS
    asked = [each for each in PROTOCOLS if not options.frames or each[0] in options.frames]
    bursts = [(*protocol, seed) for protocol in asked for seed in seeds]

    def found(runs: list[str], version: str) -> dict[Cell, Arrays]:
        cells = [(run, *each) for each in bursts for run in runs]
        if options.finished:
            return done("paper", cells, code=version)
        return worked("paper", cells, measure, code=version, workers=options.workers)

    figures = found(ours, code(*EVERYTHING)) | found([paper], str(VERSION))
    quality = {cell: float(arrays["psnr"]) for cell, arrays in figures.items()}
    noisy = {cell[1:]: float(arrays["frame"]) for cell, arrays in figures.items()}

    def row(title: str, run: str) -> str:
        mine = [[quality[run, *each, s] for s in seeds if (run, *each, s) in quality] for each in asked]
        over = [
            quality[run, *each] - quality[paper, *each]
            for each in bursts
            if {(run, *each), (paper, *each)} <= quality.keys()
        ]
        seconds = [float(figures[run, *each]["seconds"]) for each in bursts if (run, *each) in figures]
        cells = [middle(each, len(seeds)) for each in mine]
        return f"| {title} | {' | '.join(cells)} | {middle(over, 0, '+.2f')} | {middle(seconds, 0, '.0f')} |"

    yield EXPLAINED
    yield f"| | {' | '.join(map(named, asked))} | over `{PAPER}` | s |\n|{'---|' * (len(asked) + 3)}"
    frames = [middle([noisy[*each, s] for s in seeds if (*each, s) in noisy], 0) for each in asked]
    yield f"| one frame | {' | '.join(frames)} | | |"
    yield f"| the paper's own code, measured once | {' | '.join(f'{PROTOCOLS[each]}' for each in asked)} | | |"
    yield row(f"`{paper}`", paper)
    for run in ours:
        yield row(f"`{run}`", run)
    if len(quality) < len(bursts) * (len(ours) + 1):
        yield f"\nIn brackets: of how many seeds the median is, where not yet of all {len(seeds)}."


def middle(values: Iterable[float], wanted: int, style: str = ".2f") -> str:
    """The median, and of how many if they are fewer than wanted."""
    known = list(values)
    if not known:
        return ""
    return f"{median(known):{style}}" + (f" ({len(known)})" if len(known) < wanted else "")


def named(protocol: tuple[int, int, int]) -> str:
    """A column's title."""
    n, least, degrees = protocol
    return f"{n} frames, U({least / 100:g}, 1), {degrees} deg"


def unpublished() -> list[str]:
    """The priors with settings of our own, total variation first."""
    names = [name for name in prior_names() if not name.endswith(("_official", "_2021"))]
    return sorted(names, key=lambda name: name != "tv")


def measure(run: str, n: int, least: int, degrees: int, seed: int) -> Arrays:
    """PSNR in dB of a run's scene and of frame 0, seconds, and the scene."""
    frames, truth = burst(n, least / 100, degrees, seed)
    result = deepir.run(*run.split(), frames=frames)
    quality = {"psnr": result.scene, "frame": frames[0]}
    found = {name: np.array(psnr(image, truth)) for name, image in quality.items()}
    return found | {"seconds": np.array(result.metrics["seconds"]), "scene": result.scene}


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    """In dB after one gain and level, with a peak of one as the paper has it: 3 dB more than with the truth's range."""
    return float(scores(image, truth)["psnr_aligned"] - 20 * np.log10(np.ptp(truth)))


def burst(n: int, least: float, degrees: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Frames (n, H, W) float32, and what frame 0 shows."""
    grey = picture()
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[ROWS, COLUMNS].astype(float)
    centre = np.array([y.mean(), x.mean()])
    shifts = rng.uniform(-SHIFT, SHIFT, (n, 2)) * (np.arange(n) > 0)[:, None]
    angles = np.deg2rad(rng.uniform(-degrees, degrees, n)) * (np.arange(n) > 0)
    gain = rng.uniform(least, 1, x.shape[1])
    frames = []
    for (down, right), angle in zip(shifts, angles, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        v, u = y - centre[0], x - centre[1]
        at = [centre[0] + s * u + c * v + down, centre[1] + c * u - s * v + right]
        flux = gain * map_coordinates(grey, at, order=3, mode="reflect").clip(0)
        frames.append(rng.poisson(PHOTONS * flux) / PHOTONS)
    return np.array(frames, np.float32), grey[ROWS, COLUMNS]


def picture() -> np.ndarray:
    """The paper's, in [0, 1]."""
    grey = imread(Path(os.environ["DEEPIR_DATA"]) / "deepir_test" / "test1.png") / 255
    return grey if grey.ndim == 2 else grey[..., 0]


if __name__ == "__main__":
    main()
