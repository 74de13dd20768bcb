"""Quality against an oracle, and speed, of non-uniformity correction: `make bench-nuc`.

Bursts are those of nuc_regimes.py, the oracle that of nuc_oracle.py. What does not change with deepir is kept in
runs/bench-nuc, so that a second run costs deepir's own time only; `--warm` does nothing but fill it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from nuc_growth import growth
from nuc_oracle import VERSION, aligned, oracle, radiometric
from nuc_regimes import REGIMES, SEEDS, Regime, picture
from nuc_store import REGISTRATION, burst, code, kept
from nuc_table import HEADER, Case, Row, summary
from nuc_told import VERSION as TOLD
from nuc_told import told
from skimage.restoration import denoise_tv_chambolle
from written import write

import deepir
from deepir.errors import DeepIRError
from deepir.simulate import Simulation


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=["A", "B", "both"], default="both", help="pictures and seeds")
    parser.add_argument("--regime", action="append", help="only this one, or those with this in the name")
    parser.add_argument("--seeds", type=int, default=3, help="how many of the seeds to run")
    parser.add_argument("--only", choices=["quality", "growth"], help="one half of the report")
    parser.add_argument("--large", action="store_true", help="20 frames of 1280 x 1024 too")
    parser.add_argument("--fresh", action="store_true", help="take nothing from runs/bench-nuc")
    parser.add_argument("--warm", action="store_true", help="fill runs/bench-nuc, and report nothing")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(1)  # the same figures on any machine; speed is measured with all cores
    halves = "AB" if options.half == "both" else options.half
    regimes = chosen(options.regime)
    if options.warm:
        warm(regimes, halves, options.seeds, fresh=options.fresh)
        return
    script = f"benchmarks/nuc.py, seeds {[SEEDS[half][: options.seeds] for half in halves]}"
    write(report(regimes, halves, options), script, options.output)


def chosen(names: Sequence[str] | None) -> dict[str, Regime]:
    """The regimes with these names, or with one of these in the name."""
    if not names:
        return REGIMES
    found = {
        name: regime
        for name, regime in REGIMES.items()
        if any(each == name or (each not in REGIMES and each.lower() in name) for each in names)
    }
    if not found:
        raise SystemExit(f"no regime {names}; there are {', '.join(REGIMES)}")
    return found


def report(regimes: dict[str, Regime], halves: str, options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: quality by regime and number of frames, means, and speed."""
    if options.only != "growth":
        yield HEADER.format(" / ".join(f"half {half}" for half in halves))
        rows = []
        for name, regime in regimes.items():
            for n in regime.frames:
                cases = {
                    half: [case(regime, half, n, seed, options.fresh) for seed in SEEDS[half][: options.seeds]]
                    for half in halves
                }
                rows.append(Row(name, n, regime.forbidden.get(n, ""), cases))
                yield rows[-1].line()
        yield from summary(rows, halves)
    if options.only != "quality":
        yield "\n## Growth\n"
        yield "All cores; from frames in memory to the result in memory, median of three processes.\n"
        yield from growth(large=options.large)


def case(regime: Regime, half: str, n: int, seed: int, fresh: bool) -> Case:
    """All figures of one burst."""
    sim, digest = burst(regime.picture(half), regime.settings(n), seed, fresh=fresh)
    average = kept("averages", [digest, code(*REGISTRATION)], lambda: averaged(sim), fresh=fresh)
    best, left = ceilings(sim, digest, regime.picture(half), fresh=fresh)
    raw = aligned(sim.frames[0].astype(float), sim)
    try:
        result = deepir.run("nuc", frames=sim.frames)
    except DeepIRError as error:  # then one frame is what there is
        return Case(
            raw,
            float(average["plain"]),
            float(average["smooth"]),
            raw,
            left,
            best,
            np.nan,
            np.nan,
            [f"REFUSED: {error}"],
        )
    return Case(
        one_frame=raw,
        average=float(average["plain"]),
        smooth_average=float(average["smooth"]),
        deepir=aligned(result.scene, sim),
        told=left,
        oracle=best,
        radiometric=radiometric(result.scene, sim),
        seconds=result.metrics["seconds"],
        messages=result.messages,
    )


def averaged(sim: Simulation) -> dict[str, np.ndarray]:
    """PSNR of the registered average, and after scikit-image's total variation with its best weight."""
    try:
        scene = deepir.run("nuc", frames=sim.frames, method="average").scene
    except DeepIRError:
        scene = sim.frames[0].astype(float)
    span = float(np.ptp(scene))
    smooth = [span * denoise_tv_chambolle(scene / span, weight=weight) for weight in (0.02, 0.05, 0.1, 0.2)]
    best = max(aligned(each, sim) for each in smooth)
    return {"plain": np.array(aligned(scene, sim)), "smooth": np.array(best)}


def ceilings(sim: Simulation, digest: str, name: str, *, fresh: bool) -> tuple[float, float]:
    """PSNR of the oracle, and of what is told all but scene and pattern.

    They depend on the burst, and on no more of deepir than their versions stand for.
    """

    def make(best: Callable[[Simulation, np.ndarray], float]) -> Callable[[], dict[str, np.ndarray]]:
        return lambda: {"psnr": np.array(best(sim, picture(name)))}

    return (
        float(kept("oracles", [digest, VERSION], make(oracle), fresh=fresh)["psnr"]),
        float(kept("told", [digest, TOLD], make(told), fresh=fresh)["psnr"]),
    )


def warm(regimes: dict[str, Regime], halves: str, seeds: int, *, fresh: bool) -> None:
    """Simulate all bursts, and solve all that is told the truth."""
    for name, regime in regimes.items():
        for n in regime.frames:
            for half in halves:
                found = []
                for seed in SEEDS[half][:seeds]:
                    sim, digest = burst(regime.picture(half), regime.settings(n), seed, fresh=fresh)
                    found.append(ceilings(sim, digest, regime.picture(half), fresh=fresh))
                print(name, n, half, " ".join(f"{best:.2f} ({left:.2f})" for best, left in found), flush=True)


if __name__ == "__main__":
    main()
