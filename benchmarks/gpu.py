"""Seconds and quality of whole solves on a GPU and on the CPU: `python benchmarks/gpu.py --device cuda --device cpu`.

The burst is simulated: frames of 640 x 512 px that move up to 10 px, with a pattern of pixels, columns and shading.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import torch
from written import write

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, Simulation, simulate

#: The runs: a configuration and its settings. The 2021 paper states 600 s for its own network.
RUNS = (
    "nuc",
    "nuc prior=tv",
    "nuc prior=siren",
    "nuc prior=deep_decoder",
    "nuc prior=dip",
    "paper/nuc_text",
    "paper/nuc_text scene.bf16=true",
)
SHAPES = ((160, 192), (512, 640))  # px, height and width
FRAMES = 5


def report(devices: list[str], runs: list[str], shapes: list[tuple[int, int]]) -> Iterator[str]:
    """Lines of markdown: a table for each size."""
    if "cuda" in devices:
        yield f"GPU: {torch.cuda.get_device_name()}. The first run on it warms it up and is not counted.\n"
        deepir.run("nuc", "device=cuda", frames=simulate(settings=Settings(shape=(64, 64)), seed=1).frames)
    for shape in shapes:
        burst = simulate(settings=Settings(n_frames=FRAMES, shape=shape), seed=0)
        yield f"{FRAMES} x {shape[0]} x {shape[1]}, a raw frame has {raw_psnr(burst):.1f} dB\n"
        yield f"| run | {' | '.join(f'{each}, s | {each}, dB' for each in devices)} |"
        yield f"|{'---|' * (2 * len(devices) + 1)}"
        for run in runs:
            yield f"| `{run}` | {' | '.join(measure(run, device, burst) for device in devices)} |"
        yield ""


def measure(run: str, device: str, burst: Simulation) -> str:
    """Two cells of the table: seconds, and PSNR in dB after one gain and level."""
    result = deepir.run(*run.split(), f"device={device}", frames=burst.frames, truth=burst.truth.scene)
    return f"{result.metrics['seconds']:.1f} | {result.metrics['psnr_aligned']:.2f}"


def raw_psnr(burst: Simulation) -> float:
    return float(scores(burst.frames[0], burst.truth.scene)["psnr_aligned"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", action="append", help="cuda, mps or cpu; several may be given")
    parser.add_argument("--run", action="append", help="only this configuration, with its settings")
    parser.add_argument("--large", action="store_true", help="only 640 x 512")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    devices = options.device or ["cuda" if torch.cuda.is_available() else "cpu"]
    shapes = SHAPES[1:] if options.large else SHAPES
    write(report(devices, options.run or list(RUNS), list(shapes)), "benchmarks/gpu.py", options.output)


if __name__ == "__main__":
    main()
