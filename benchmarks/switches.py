"""What a network's switches gain in time, and cost in quality: `make bench-switches`.

Time: an iteration of `dip_official` at 128 x 128 px against the same network in plain torch, repeats by turns. Quality:
`dip` with and without each switch on the same bursts, from the same seeds; the interval is that of the mean (95 %).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from cells import EVERYTHING, Arrays, worked
from nuc_oracle import aligned
from nuc_regimes import CLEAN, NO_OFFSET, UNIT, picture
from nuc_store import code
from scipy.stats import t
from torch import Tensor
from written import write

import deepir
from deepir.priors.networks.dip import DIP
from deepir.priors.networks.skip_network import Skip
from deepir.simulate import Settings, simulate

PICTURES, SEEDS = ("coffee", "rocket", "coins", "brick", "cat"), (501, 502, 503, 504)
DEFAULT = "scene.bf16=true"
#: Switch -> the run with it, and the one without.
SWITCHES = {
    "bfloat16": (DEFAULT, "scene.bf16=false"),
    "`up=nearest` instead of bilinear": ("scene.up=nearest", DEFAULT),
    "`pad=zeros` instead of reflection": ("scene.pad=zeros", DEFAULT),
}
SIDE, REPEATS = 128, 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--workers", type=int, default=1, help="processes of one thread each, for the quality")
    parser.add_argument("--threads", type=int, action="append", help="of torch, for the times; default 1")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    write(report(options), "benchmarks/switches.py", options.output)


def report(options: argparse.Namespace) -> Iterator[str]:
    """Lines of markdown: times, then quality."""
    for threads in options.threads or [1]:
        torch.set_num_threads(threads)
        found = times()
        yield f"| an iteration, {threads} threads | ms | of plain torch |\n|---|---|---|"
        for name, seconds in found.items():
            yield f"| {name} | {1000 * seconds:.0f} | {seconds / found['plain torch']:.2f} |"
        yield ""
    yield "| switch of `dip` | PSNR with, less without | 95 % of the mean | time with, of without |"
    yield "|---|---|---|---|"
    bursts = [(name, seed) for name in PICTURES for seed in SEEDS]
    runs = dict.fromkeys(each for pair in SWITCHES.values() for each in pair)
    wanted = [(run, *burst) for burst in bursts for run in runs]
    kept = worked("switches", wanted, measure, code=code(*EVERYTHING), workers=options.workers)
    for name, (on, off) in SWITCHES.items():
        pairs = [(kept[on, *burst], kept[off, *burst]) for burst in bursts]
        gains = np.array([float(a["psnr"] - b["psnr"]) for a, b in pairs])
        spread = t.ppf(0.975, len(gains) - 1) * gains.std(ddof=1) / len(gains) ** 0.5
        ratio = np.median([float(a["seconds"] / b["seconds"]) for a, b in pairs])
        yield f"| {name} | {gains.mean():+.2f} dB | +- {spread:.2f} | {ratio:.2f} |"


def measure(run: str, name: str, seed: int) -> Arrays:
    """PSNR in dB after one gain and level, and seconds, of five frames of 64 x 80 px."""
    camera = CLEAN | UNIT | NO_OFFSET | {"gain_column": 0.1, "gain_pixel": 0.02}
    sim = simulate(picture(name), Settings(n_frames=5, shape=(64, 80), max_shift=6.0, **camera), seed=seed)
    result = deepir.run("nuc", "prior=dip", run, f"seed={seed}", frames=sim.frames)
    return {"psnr": np.array(aligned(result.scene, sim)), "seconds": np.array(result.metrics["seconds"])}


class Plain(Skip):
    """The network as torch computes it if it is left to it."""

    def _risen(self, i: int, beside: Tensor, deep: Tensor) -> Tensor:
        doubled = F.interpolate(deep, scale_factor=2, mode=self.up)
        upsample_join_convolve: Tensor = self.rise[i](self.join[i](torch.cat((beside, doubled), 1)))
        return upsample_join_convolve


def times() -> dict[str, float]:
    """Least seconds of an iteration: the network, its gradient, and a step of Adam."""
    noise = 0.1 * torch.rand(1, 32, SIDE, SIDE)
    plain = Plain(32, [128] * 5)
    ways: dict[str, tuple[torch.nn.Module, Callable[[], Tensor], bool]] = {
        "plain torch": (plain, lambda: plain(noise).sigmoid(), False)
    }

    def ours(name: str, *, fused: bool = False, **options: object) -> None:
        field = DIP((1, 1, SIDE, SIDE), width=128, inputs=32, sigmoid=True, **options)
        ways[name] = (field, field.__call__, fused)

    ours("`dip_official`: channels last")
    ours("and `scene.bf16=true`", bf16=True)
    ours("and fused Adam", bf16=True, fused=True)
    ours("and `scene.up=nearest scene.pad=zeros`", bf16=True, up="nearest", pad="zeros")
    adam = {name: torch.optim.Adam(net.parameters(), 0.01, fused=fused) for name, (net, _, fused) in ways.items()}
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(REPEATS + 1):
        for name, (_, draw, _) in ways.items():
            began = time.perf_counter()
            adam[name].zero_grad()
            draw().square().sum().backward()
            adam[name].step()
            seconds[name].append(time.perf_counter() - began)
    return {name: min(each[1:]) for name, each in seconds.items()}


if __name__ == "__main__":
    main()
