"""Quality and time of every prior: `make bench-priors`.

Bursts are of two regimes of nuc_regimes.py, half A, and, for super-resolution, of sr.py with fewer pixels. A prior's
own start is the scene that it is fitted from, the sensor already known: the result of total variation, or the
registered average; a network that draws all of the scene starts from nothing. What is finished is kept: a run that
was cut short goes on where it was, until the package or a preset is changed.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from statistics import median

import numpy as np
import sr
from cells import EVERYTHING, Arrays, worked
from nuc_oracle import aligned
from nuc_regimes import REGIMES, SEEDS
from nuc_store import burst, code
from written import write

import deepir
from deepir.config import Config, load, prior_names
from deepir.metrics import align
from deepir.report.panels import write_panels
from deepir.simulate import Simulation

CHOSEN = ("columns U(.5, 1)", "counts")
FRAMES = (3, 5, 10)
#: What stands for the start of a prior: one that draws what is added, before its first iteration.
STARTS = {"tv": "dip_residual", "average": "dip"}
FINE = ((2, 8), (4, 16))  # factor and frames of super-resolution
FINE_PICTURES = ("rocket", "procedural 40")  # not coffee: the denoiser `cnn` has learnt from it
FINE_SHAPE, FINE_SHIFT = (40, 48), 6.0  # of its frames: small, for every prior is run
FINE_SEEDS = (301, 302, 303)
SHOWN = ("nuc", CHOSEN[0], 5)  # the burst of the picture, at the first seed
PART, ERROR = np.s_[56:136, 72:184], 0.03  # what is shown of it, and the error that is black or white
EXPLAINED = f"""# Every prior

Medians of PSNR in dB, after one gain and level, and of seconds of one thread. Non-uniformity correction:
{" and ".join(CHOSEN)}, 160 x 192 px. Super-resolution: {" and ".join(FINE_PICTURES)}, frames of 40 x 48 px. "Over own
start": over what the prior is fitted from, the sensor already known. "From the average": the same network started from
the registered average, over what it reaches from its own start. [Priors](../docs/explanation/priors.md) says what the
priors are.

![Errors of the scenes that the priors find](../docs/images/priors.png)"""

Burst = tuple[str, str, int, int]  # problem, regime or picture, frames or factor, seed


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3, help="how many of the seeds to run")
    parser.add_argument("--prior", action="append", help="only this one")
    parser.add_argument("--published", action="store_true", help="those with published settings too: hours")
    parser.add_argument("--workers", type=int, default=1, help="processes of one thread each")
    parser.add_argument("--panels", type=Path, help="write a picture of a burst's errors here")
    parser.add_argument("--output", type=Path, help="write the tables to this file too")
    options = parser.parse_args()
    names = options.prior or [name for name in prior_names() if options.published or not published(name)]
    names = ["tv", *(name for name in names if name != "tv")]
    nuc = [("nuc", regime, n, seed) for seed in SEEDS["A"][: options.seeds] for regime in CHOSEN for n in FRAMES]
    fine = [
        ("sr", picture, factor, seed)
        for seed in FINE_SEEDS[: options.seeds]
        for picture in FINE_PICTURES
        for factor, _ in FINE
    ]
    runs = [*(f"prior={name}" for name in names), *map(restarted, others_start(names))]
    runs += [f"prior={prior} scene.fit.iterations=0" for prior in STARTS.values()]
    found = worked(
        "priors",
        [(run, *each) for each in [*nuc, *fine] for run in runs],
        measure,
        code=code(*EVERYTHING),
        workers=options.workers,
    )
    script = f"benchmarks/priors.py, seeds {SEEDS['A'][: options.seeds]}"
    write(report(names, found, nuc, fine), script, options.output)
    if options.panels:
        show(options.panels, names, found, (*SHOWN, SEEDS["A"][0]))


def published(name: str) -> bool:
    """Whether a preset holds published settings."""
    return name.endswith(("_official", "_2021"))


def others_start(names: Sequence[str]) -> list[str]:
    """The networks among them that start from the result of total variation."""
    scenes = {name: load("nuc", [f"prior={name}"]).scene for name in names}
    return [name for name, each in scenes.items() if each.get("init") == "tv" and each["type"] != "pixels"]


def restarted(name: str) -> str:
    """The run of such a network from the average."""
    return f"prior={name} scene.init=average"


def measure(run: str, problem: str, what: str, number: int, seed: int) -> Arrays:
    """PSNR in dB after one gain and level, seconds, and the scene."""
    sim = simulated(problem, what, number, seed)
    more = [f"physics.downsample.factor={number}"] if problem == "sr" else []
    result = deepir.run(problem, *run.split(), *more, frames=sim.frames)
    scene = np.asarray(result.scene, np.float32)
    return {"psnr": np.array(aligned(scene, sim)), "seconds": np.array(result.metrics["seconds"]), "scene": scene}


def simulated(problem: str, what: str, number: int, seed: int) -> Simulation:
    """The burst of a cell."""
    if problem == "nuc":
        return burst(REGIMES[what].picture("A"), REGIMES[what].settings(number), seed)[0]
    return sr.burst(what, number, dict(FINE)[number], seed, shape=FINE_SHAPE, max_shift=FINE_SHIFT)[0]


def report(
    names: Sequence[str], found: dict[tuple[str, ...], Arrays], nuc: Sequence[Burst], fine: Sequence[Burst]
) -> Iterator[str]:
    """Lines of markdown: medians over bursts of PSNR in dB, and of seconds."""
    yield EXPLAINED
    yield "\n## Non-uniformity correction\n"
    yield from table(names, found, nuc, {n: f"{n} frames" for n in FRAMES})
    yield "\n## Super-resolution\n"
    yield from table(names, found, fine, {factor: f"x{factor}, {n} frames" for factor, n in FINE})


def table(
    names: Sequence[str], found: dict[tuple[str, ...], Arrays], bursts: Sequence[Burst], columns: dict[int, str]
) -> Iterator[str]:
    """A row for each prior."""
    end, helpless = ("over TV", "over own start", "from the average", "s"), []
    yield f"| prior | start | {' | '.join([*columns.values(), *end])} |"
    yield f"|{'---|' * (len(columns) + 2 + len(end))}"
    again = others_start(names)

    def psnr(run: str, each: Burst) -> float:
        return float(found[run, *each]["psnr"])

    def over(run: str, other: str) -> float:
        return median(psnr(run, each) - psnr(other, each) for each in bursts)

    for name in names:
        run, config = f"prior={name}", load("nuc", [f"prior={name}"])
        by_column = [median(psnr(run, each) for each in bursts if each[2] == key) for key in columns]
        start = begins_at(config)
        own = f"prior={STARTS[start]} scene.fit.iterations=0" if start in STARTS else ""
        cells = [name, start, *(f"{each:.2f}" for each in by_column), f"{over(run, 'prior=tv'):+.2f}"]
        cells.append(f"{over(run, own):+.2f}" if own else "")
        lost = over(restarted(name), run) if name in again else 0.0
        helpless += [name] if lost < -1 else []
        cells.append(f"{lost:+.2f}" if name in again else "")
        seconds = median(float(found[run, *each]["seconds"]) for each in bursts)
        yield f"| {' | '.join([*cells, f'{seconds:.1f}'])} |"
    if helpless:
        names_of = ", ".join(f"`{name}`" for name in helpless)
        yield f"\nMore than 1 dB is lost from the average by {names_of}: it is the start that works, not the prior."


def begins_at(config: Config) -> str:
    """From what the scene is fitted, once the sensor is known."""
    scene = config.scene
    if not scene.get("fit"):
        return ""
    shown = scene.get("residual") or scene.get("picture") or scene["type"] == "pixels"
    return str(scene.get("init", "average")) if shown else "nothing"


def show(path: Path, names: Sequence[str], found: dict[tuple[str, ...], Arrays], case: Burst) -> None:
    """Write a picture of how far the scenes that all priors find are from the truth, of a part of a burst."""
    sim = simulated(*case)
    truth, (y, x) = sim.truth.scene, PART
    known = np.ones(truth.shape, bool)
    quality = {name: float(found[f"prior={name}", *case]["psnr"]) for name in names}
    frame = align(sim.frames[0].astype(float), truth, known)
    panels = [("truth", truth[y, x], 0.0, 1.0), ("one frame", frame[y, x], 0.0, 1.0)]
    for name in sorted(names, key=quality.__getitem__, reverse=True):
        error = align(found[f"prior={name}", *case]["scene"].astype(float), truth, known) - truth
        panels.append((f"{name}, {quality[name]:.1f} dB", error[y, x], -ERROR, ERROR))
    write_panels(path, panels, rows=-(-len(panels) // 5))


if __name__ == "__main__":
    main()
