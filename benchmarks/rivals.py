"""The default against every rival, in one run: `make bench-rivals`.

Two protocols of non-uniformity correction, and super-resolution. Nobody tunes on these pictures and seeds. Everybody
has deepir's registration.
"""

from __future__ import annotations

import argparse
import platform
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from nuc_regimes import picture

import deepir
from deepir.metrics import align, scores
from deepir.registry import components
from deepir.report.panels import write_panels
from deepir.result import Result
from deepir.simulate import Settings, Simulation, simulate

PICTURES = {"coffee": 401, "rocket": 402, "chelsea": 403, "procedural 60": 404}  # and their seeds
FRAMES = (3, 5, 10)
CLEAN: dict[str, Any] = {"shading": 0.0, "dead_pixels": 0.0, "psf_sigma": 0.0, "read_noise": 0.002}
NO_OFFSET: dict[str, Any] = {"offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0}
COLUMNS: dict[str, Any] = {
    "gain_distribution": "uniform",
    "gain_column": 0.5,
    "gain_pixel": 0.0,
    "photons": 1000.0,
}
COUNTS: dict[str, Any] = {"counts": True, "dead_pixels": 0.0}
#: Not for this problem: an enlarged frame, and what adds up on a finer grid.
LEFT_OUT = {"nuc": ("bicubic", "shift_and_add", "vdsr"), "sr": ("flat_field",)}


@dataclass(frozen=True)
class Protocol:
    """A camera, and what is asked of its bursts."""

    title: str
    camera: Mapping[str, Any]
    problem: str = "nuc"
    frames: tuple[int, ...] = FRAMES


PROTOCOLS = (
    Protocol(
        "The paper's: column gain U(.5, 1), 1,000 photons, shifts +-10 px, rotations up to 6 degrees",
        CLEAN | NO_OFFSET | COLUMNS | {"max_rotation": 6.0},
    ),
    Protocol("14-bit counts: gain, offset, shading and noise of a microbolometer", COUNTS),
    Protocol(
        "Super-resolution by 2: 14-bit counts, 64 x 80 px",
        COUNTS | {"factor": 2, "shape": (64, 80)},
        problem="sr",
        frames=(16,),
    ),
)  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--method", action="append", help="only this one")
    parser.add_argument("--panels", type=Path, help="write a picture of all methods here")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    if options.panels:
        write_picture(options.panels, names("nuc", options.method))
        return
    lines = [
        f"<!-- written by benchmarks/rivals.py: deepir {deepir.__version__}, torch {torch.__version__}, "
        f"python {platform.python_version()}, one thread -->",
        "# The default against every rival",
        "",
        f"Medians over {', '.join(PICTURES)}; seeds {[*PICTURES.values()]}. [rivals.md](rivals.md) says what the",
        "methods are. PSNR and SSIM are taken after one gain and level. Radiometric: root mean square error after one",
        "level, in % of the range; columns: what is left of a column pattern, in % of the range. `joint` is the",
        "default. `flat_field` is told more than the others: sixteen frames each of a cold and a hot black body.",
    ]
    for line in report(options.method):
        print(line, flush=True)
        lines.append(line)
    if options.output:
        options.output.write_text("\n".join(lines) + "\n")


def report(only: list[str] | None) -> Iterator[str]:
    """Lines of markdown: a table for each protocol and number of frames."""
    for protocol in PROTOCOLS:
        for n in protocol.frames:
            yield f"\n## {protocol.title}; {n} frames\n"
            yield "| method | PSNR, dB | SSIM | radiometric, % | columns, % | seconds |"
            yield "|---|---|---|---|---|---|"
            bursts = [burst(protocol, name, n) for name in PICTURES]
            found = {
                method: [figures(run(method, protocol.problem, sim), sim) for sim in bursts]
                for method in names(protocol.problem, only)
            }
            medians = {method: np.median(each, axis=0) for method, each in found.items()}
            for method in sorted(medians, key=lambda method: -medians[method][0]):
                psnr, ssim, error, columns, seconds = medians[method]
                yield f"| {method} | {psnr:.1f} | {ssim:.3f} | {error:.2f} | {columns:.2f} | {seconds:.1f} |"


def names(problem: str, only: list[str] | None) -> list[str]:
    """The methods that are compared: all that are registered, but for those that are not for this problem."""
    return only or [name for name in components("method") if name not in LEFT_OUT[problem]]


def burst(protocol: Protocol, name: str, n: int) -> Simulation:
    """Frames of a picture, and what made them."""
    return simulate(picture(name), Settings(n_frames=n, **protocol.camera), seed=PICTURES[name])


def run(method: str, problem: str, sim: Simulation) -> Result:
    """The result of a method."""
    settings = [f"physics.downsample.factor={sim.settings.factor}"] if problem == "sr" else []
    if method != "flat_field":
        return deepir.run(problem, *settings, frames=sim.frames, method=method)
    with tempfile.TemporaryDirectory() as folder:
        files = calibration(Path(folder), sim)
        return deepir.run(problem, *settings, frames=sim.frames, method={"type": method, **files})


def calibration(folder: Path, sim: Simulation) -> dict[str, str]:
    """Files with sixteen frames each of a cold and a hot black body, at the ends of the scene's range."""
    truth, rng, files = sim.truth, np.random.default_rng(sim.seed), {}
    for name, flux in (("cold", truth.scene.min()), ("hot", truth.scene.max())):
        clean = truth.gain * flux
        shot = clean.clip(min=0) / truth.photons_per_unit if truth.photons_per_unit else 0.0
        noise = np.sqrt(truth.read_noise**2 + shot) * rng.standard_normal((16, *clean.shape))
        files[name] = str(folder / f"{name}.npy")
        np.save(files[name], (clean + truth.offset + noise).astype(np.float32))
    return files


def figures(result: Result, sim: Simulation) -> tuple[float, ...]:
    """PSNR, SSIM, radiometric error, residual columns and seconds."""
    truth, contrast = sim.truth.scene, sim.settings.range
    found = scores(result.scene, truth)
    error = align(result.scene.astype(float), truth, np.isfinite(truth)) - truth
    columns = np.diff(error.mean(0)).std() / 2**0.5
    percent = (100 * each / contrast for each in (found["radiometric_rmse"], columns))
    return found["psnr_aligned"], found["ssim_aligned"], *percent, result.metrics["seconds"]


def write_picture(path: Path, methods: list[str]) -> None:
    """The drawn scene under the paper's protocol, five frames, by every method."""
    sim = burst(PROTOCOLS[0], "procedural 60", 5)
    truth = sim.truth.scene
    everything = np.ones(truth.shape, bool)
    shown = {"one frame": sim.frames[0].astype(float), "truth": truth}
    shown |= {method: run(method, "nuc", sim).scene.astype(float) for method in methods}
    aligned = {title: align(image, truth, everything) for title, image in shown.items()}
    order = sorted(shown, key=lambda title: scores(shown[title], truth)["psnr_aligned"])
    panels = [(_title(name, shown[name], truth), aligned[name], 0.0, float(truth.max())) for name in order]
    write_panels(path, panels, rows=-(-len(panels) // 4))


def _title(name: str, image: np.ndarray, truth: np.ndarray) -> str:
    quality = "" if image is truth else f", {scores(image, truth)['psnr_aligned']:.1f} dB"
    return ("deepir (joint)" if name == "joint" else name) + quality


if __name__ == "__main__":
    main()
