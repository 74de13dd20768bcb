"""Quality against an oracle, and speed, of non-uniformity correction: `make bench-nuc`.

The oracle is the same total variation reconstruction given the true gain, offset, motion and noise, with the weight
that is best on the truth. The pictures and seeds here are for reporting: strengths were never tuned on them.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import skimage.data
import torch
from skimage.color import rgb2gray
from skimage.restoration import denoise_tv_chambolle

import deepir
from deepir.build import build
from deepir.burst import Burst
from deepir.config import load
from deepir.metrics import scores
from deepir.problems.definition import start_scene
from deepir.scenes import procedural
from deepir.simulate import Settings, Simulation, simulate
from deepir.solve import Stage, Step, solve

CLEAN = {"shading": 0.0, "dead_pixels": 0.0, "level_drift": 0.0}
UNIT = {"photons": 1000.0, "read_noise": 0.002}
NO_OFFSET = {"offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0}
#: Name -> (picture of scikit-image, or the seed of a procedural scene; the camera).
REGIMES: dict[str, tuple[str | int, dict[str, object]]] = {
    "columns 10 %": ("coins", UNIT | NO_OFFSET | {"gain_column": 0.1, "gain_pixel": 0.02}),
    "columns 30 %": ("rocket", UNIT | NO_OFFSET | {"gain_column": 0.3, "gain_pixel": 0.02}),
    "columns U(.5, 1)": (
        20, UNIT | NO_OFFSET | {"gain_distribution": "uniform", "gain_column": 0.5, "gain_pixel": 0.0},
    ),
    "pixels 5 %": ("brick", UNIT | {"gain_pixel": 0.05, "gain_column": 0.02, "max_shift": 6.0}),
    "pixels 10 %": (21, UNIT | NO_OFFSET | {"gain_pixel": 0.1}),
    "rows 5 %": (22, UNIT | {"gain_row": 0.05, "offset_row": 0.05}),
    "rotation 6 deg": ("coffee", UNIT | {"gain_column": 0.05, "max_rotation": 6.0}),
    "tau 200": ("chelsea", UNIT | {"gain_column": 0.05, "gain_pixel": 0.05, "photons": 200.0}),
    "counts": ("stereo_motorcycle", {"counts": True, "read_noise": 0.004}),
    "counts, strong offset, rotation": (
        23, {"counts": True, "read_noise": 0.003, "offset_column": 0.1, "offset_pixel": 0.1, "max_rotation": 3.0},
    ),
}  # fmt: skip
FRAMES, SEEDS = (3, 5, 10), (101, 102, 103)
ORACLE_FACTORS = (4.0, 2.0, 1.0, 0.5, 0.25)  # of the natural weight
HEADER = (
    "| regime | n | one frame | average | average + scikit-image TV | deepir | oracle | gap | seconds, 1 thread |\n"
    "|---|---|---|---|---|---|---|---|---|"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=len(SEEDS), help="how many of the seeds to run")
    parser.add_argument("--output", type=Path, help="write the tables to this file too")
    options = parser.parse_args()
    torch.set_num_threads(1)  # the same figures on any machine; the speed is measured with all cores
    lines = []
    for line in report(SEEDS[: options.seeds]):
        print(line, flush=True)
        lines.append(line)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


def report(seeds: tuple[int, ...]) -> Iterator[str]:
    """Lines of markdown: quality by regime and number of frames, means, and speed."""
    yield f"<!-- written by benchmarks/nuc.py: deepir {deepir.__version__}, torch {torch.__version__}, "
    yield f"python {platform.python_version()}, seeds {seeds} -->"
    yield "PSNR in dB after one best gain and level; median over seeds.\n"
    yield HEADER
    gaps: dict[int, list[float]] = {n: [] for n in FRAMES}
    for name, (picture, camera) in REGIMES.items():
        for n in FRAMES:
            rows = [case(simulation(picture, camera, n, seed)) for seed in seeds]
            gaps[n] += [row["gap"] for row in rows]
            middle = {key: float(np.median([row[key] for row in rows])) for key in rows[0]}
            yield f"| {name} | {n} | " + " | ".join(f"{value:.1f}" for value in middle.values()) + " |"
    means = ", ".join(f"n = {n}: {np.mean(values):.2f}" for n, values in gaps.items())
    mean = np.mean([gap for values in gaps.values() for gap in values])
    yield f"\nMean gap to the oracle: **{mean:.2f} dB** ({means}).\n"
    yield f"{os.cpu_count()} cores, all used:\n"
    yield "| burst | seconds | evaluations | peak memory, MB |\n|---|---|---|---|"
    for shape in ((160, 192), (512, 640)):
        yield speed(shape)


def simulation(picture: str | int, camera: dict[str, object], n: int, seed: int) -> Simulation:
    """A burst of 160 x 192 px."""
    scene = None if isinstance(picture, str) else procedural(picture, (430, 500))
    if isinstance(picture, str):
        scene = (
            np.asarray(
                getattr(skimage.data, picture)()[0]
                if picture.startswith("stereo")
                else getattr(skimage.data, picture)()
            )
            / 255
        )
        scene = rgb2gray(scene) if scene.ndim == 3 else scene
    return simulate(scene, Settings(n_frames=n, **(CLEAN | camera)), seed=seed)  # type: ignore[arg-type]


def case(sim: Simulation) -> dict[str, float]:
    """PSNR of one frame, average, denoised average, deepir and the oracle; the gap; seconds."""
    result = deepir.run("nuc", frames=sim.frames)
    average = deepir.run("nuc", frames=sim.frames, method="average").scene
    best = oracle(sim)
    found = aligned(result.scene, sim)
    return {
        "one frame": aligned(sim.frames[0].astype(float), sim),
        "average": aligned(average, sim),
        "average + TV": max(aligned(denoised(average, weight), sim) for weight in (0.02, 0.05, 0.1, 0.2)),
        "deepir": found,
        "oracle": best,
        "gap": best - found,
        "seconds": result.metrics["seconds"],
    }


def aligned(scene: np.ndarray, sim: Simulation) -> float:
    """PSNR against the truth after one gain and level."""
    return scores(scene, sim.truth.scene)["psnr_aligned"]


def denoised(scene: np.ndarray, weight: float) -> np.ndarray:
    """scikit-image's total variation, on the scene scaled to its range."""
    span = float(np.ptp(scene))
    return span * denoise_tv_chambolle(scene / span, weight=weight)


def oracle(sim: Simulation) -> float:
    """Best PSNR of the reconstruction that knows the sensor, the motion and the noise."""
    truth = sim.truth
    frames = sim.frames.astype(np.float32)
    burst = Burst(frames, np.ones(frames.shape, bool), np.zeros(frames.shape[1:], bool))
    config = load("nuc", ["physics.sensor.gain=constant", "physics.sensor.offset=constant"])
    problem, geometry = build(config, burst, torch.from_numpy(truth.motion))
    for name in ("gain", "offset"):
        problem.fields[name].values.copy_(torch.from_numpy(getattr(truth, name)))
    variance = truth.read_noise**2 + (1 / 12 if sim.settings.counts else 0)
    if truth.photons_per_unit:
        variance = variance + np.clip(frames, 0.25 / truth.photons_per_unit, None) / truth.photons_per_unit
    variance = torch.from_numpy(np.broadcast_to(np.asarray(variance, np.float32), frames.shape).copy())[
        :, None
    ]
    problem.precision.copy_((problem.precision > 0) / variance)
    start_scene(problem)
    penalty = problem.penalties["scene"]["tv"]
    natural = penalty.natural(float(problem.precision.sum(0).median().rsqrt()))
    y0, y1, x0, x1 = geometry.window
    found = []
    for factor in ORACLE_FACTORS:
        penalty.weight.fill_(factor * natural)
        solution = solve(problem, [Stage("oracle", (Step(("scene",)),), 60)])
        found.append(aligned(solution.values["scene"][0, 0, y0:y1, x0:x1].numpy(), sim))
    return max(found)


def speed(shape: tuple[int, int]) -> str:
    """A table row: five frames, as `deepir.run` takes them from memory to memory; median of three processes."""
    code = (
        "import deepir; from deepir.simulate import Settings, simulate;"
        f"s = simulate(None, Settings(shape={shape}, counts=True, shading=0., dead_pixels=0.), seed=200);"
        "m = deepir.run('nuc', frames=s.frames).metrics;"
        "print(m['seconds'], m['evaluations'], m['peak_memory_mb'], sep=' | ')"
    )
    command = [sys.executable, "-c", code]
    runs = [subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(3)]
    middle = sorted(runs, key=lambda out: float(out.split("|")[0]))[1]
    return f"| 5 x {shape[1]} x {shape[0]} | {middle.strip()} |"


if __name__ == "__main__":
    main()
