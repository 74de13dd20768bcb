"""Every problem with several priors, in one table: `make bench-problems`.

Two bursts of each problem, of those of its own benchmark. What is done is kept in runs/bench-nuc until the package
changes: a run that was interrupted goes on, and `--problem` does a part; a last run without it makes the table.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import deconv
import flow
import lag
import multiview
import narcissus
import numpy as np
import sr
import torch
from nuc_oracle import aligned
from nuc_regimes import REGIMES, SEEDS
from nuc_store import burst, code, kept
from written import write

import deepir
from deepir import Result
from deepir.simulate import Simulation

PRIORS = ("tv", "foe", "tgv", "red", "deep_decoder", "siren")
Quality = Callable[[np.ndarray, Simulation], float]


@dataclass(frozen=True)
class Case:
    """A burst, and what is asked of its result."""

    label: str
    make: Callable[[], Simulation]
    #: What the problem finds beside the scene, in words.
    found: Callable[[Result, Simulation], str]
    quality: Quality = aligned  # PSNR in dB
    options: tuple[str, ...] = ()
    method: str = "average"  # for one who knows nothing better


def only(make: Callable[..., tuple[Simulation, Any]], *which: Any) -> Callable[[], Simulation]:
    """The burst, of a function that gives more."""
    return lambda: make(*which)[0]


def pattern(result: Result, sim: Simulation) -> str:
    return f"pattern, correlation {multiview.likeness(result, sim)[0]:.3f}"


def stray(result: Result, sim: Simulation) -> str:
    return f"stray flux, {100 * narcissus.left_over(result, sim):.0f} % left"


def width(sigma: float) -> Callable[[Result, Simulation], str]:
    return lambda result, _: f"blur, {deconv.spread(result.extra['psf']):.2f} px (true: {sigma:g})"


def tau(result: Result, sim: Simulation) -> str:
    return f"tau, {result.extra['tau'].mean():.2f} ms (true: {sim.settings.tau:g})"


def motion(result: Result, sim: Simulation) -> str:
    return f"flow, off by {flow.end_point_error(result.extra['flow'], sim):.3f} px"


def frame(picture: str, sigma: float) -> Case:
    """One blurred frame."""
    label = f"{picture}, blur of {sigma:g} px, one frame"
    options = (f"physics.blur.radius={deconv.RADIUS}",)
    make = partial(deconv.frame, picture, {"psf_sigma": sigma})
    return Case(label, make, width(sigma), deconv.psnr, options)


CASES: dict[str, list[Case]] = {
    "nuc": [
        Case(
            f"{name}, {REGIMES[name].picture('B')}, 5 frames",
            only(burst, REGIMES[name].picture("B"), REGIMES[name].settings(5), SEEDS["B"][0]),
            pattern,
        )
        for name in ("columns U(.5, 1)", "counts")
    ],
    "sr": [
        Case(
            f"{name}, x {factor}, 8 frames",
            only(sr.burst, name, factor, 8, sr.SEEDS[0]),
            pattern,
            options=(f"physics.downsample.factor={factor}",),
            method="bicubic",
        )
        for name, factor in (("rocket", 2), ("procedural 40", 4))
    ],
    "narcissus": [
        Case("photons, ring of 100 %, procedural 40", partial(narcissus.burst, 7), stray),
        Case("counts, smooth of 100 %, coffee", partial(narcissus.burst, 12), stray),
    ],
    "deconv": [frame("coffee", 1.5), frame("procedural 40", 2.0)],
    "deblur_lag": [
        Case("coffee, 10 ms, 5 frames", only(lag.burst, "coffee", 10.0, 5), tau),
        Case("procedural 40, 12 ms, 5 frames", only(lag.burst, "procedural 40", 12.0, 5), tau),
    ],
    "multiview_nuc": [
        Case(label, partial(multiview.burst, multiview.BURSTS[name], multiview.SEEDS[0]), pattern, multiview.quality)
        for label, name in (
            ("offsets of 3, 2 and 2 %, 5 scenes", "the same, 5 frames"),
            ("counts, gain and offset, 10 scenes", "counts: gain and offset, dead pixels"),
        )
    ],
    "flow": [
        Case(f"{name}, parallax of {px:g} px", partial(flow.burst, name, px), motion)
        for name, px in (("rocket", 2.0), ("procedural 40", 5.0))
    ],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problem", action="append", choices=CASES, help="only this one; may be given again")
    parser.add_argument("--fresh", action="store_true", help="take nothing from runs/bench-nuc")
    parser.add_argument("--output", type=Path, help="write the table to this file too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    write(report(options.problem or list(CASES), fresh=options.fresh), "benchmarks/problems.py", options.output)


def report(problems: list[str], *, fresh: bool) -> Iterator[str]:
    """Lines of markdown: a row for each burst, PSNR in dB of the scene with each prior."""
    yield (
        "# Every problem, several priors\n\nTwo bursts of each problem, from its own benchmark. PSNR in dB after one "
        "gain and level (`deconv`: as it is); without: the registered average, in `sr` bicubic, in `deconv` and "
        "`multiview_nuc` the frames. What else is found, and seconds on one thread: with `tv`.\n"
    )
    yield f"| problem | burst | without | {' | '.join(PRIORS)} | found beside the scene | s |"
    yield "|---" * (5 + len(PRIORS)) + "|"
    for problem in problems:
        for case in CASES[problem]:
            without, *cells = [cell(problem, case, prior, fresh=fresh) for prior in (None, *PRIORS)]
            quality = [f"{float(each['psnr']):.1f}" for each in (without, *cells)]
            first = cells[0]
            yield (
                f"| `{problem}` | {case.label} | {' | '.join(quality)} | {first['found']} | "
                f"{float(first['seconds']):.1f} |"
            )


def cell(problem: str, case: Case, prior: str | None, *, fresh: bool) -> dict[str, np.ndarray]:
    """What is kept of a run: `psnr`, `found` and `seconds`; without a prior those of the plain method."""

    def make() -> dict[str, np.ndarray]:
        sim = case.make()
        choice = {"prior": prior} if prior else {"method": case.method}
        result = deepir.run(problem, *case.options, "threads=1", frames=sim.frames, **choice)
        found = case.found(result, sim) if prior else ""
        figures = {"psnr": case.quality(result.scene, sim), "seconds": result.metrics["seconds"], "found": found}
        return {name: np.array(each) for name, each in figures.items()}

    key = ["problems", problem, case.label, prior, code("**/*.py", "../configs/**/*.yaml")]
    return kept("problems", key, make, fresh=fresh)


if __name__ == "__main__":
    main()
