"""Dense motion: how well the displacements are found, and what they are worth. `make bench-flow` prints the tables.

Simulated bursts with parallax: the scene's quality, and the displacements' mean end-point error where there is texture.
A FLIR A65 in a moving car, where `DEEPIR_DATA` names the folder of the data: how well a frame that no fit has seen is
predicted. Its motion is found on half of its samples, in squares of 4 x 4 px, and the error is that of the other half.
Constants were tuned on other pictures and seeds.
"""

from __future__ import annotations

import argparse
import itertools
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from nuc_regimes import picture
from scipy import ndimage
from written import write

import deepir
from deepir.effects.noise import update_noise
from deepir.fields.base import Pixels
from deepir.fields.constant import Constant
from deepir.fields.motion import Flow, Homography
from deepir.metrics import scores
from deepir.operators import Chain, Sensor, Warp
from deepir.operators.motion_models import displacements
from deepir.operators.warp import project_pixels
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.optical_flow import optical_flow
from deepir.registration import register
from deepir.report.panels import write_panels
from deepir.schedule import Stage, Step
from deepir.simulate import Settings, Simulation, simulate

PICTURES = ("coffee", "rocket", "procedural 40")
PRIORS = ("foe", "tv", "tgv", "red")
SEED, FRAMES, PARALLAX = 301, 6, (2.0, 5.0)
CAMERA = Settings(n_frames=FRAMES, shape=(128, 160), counts=True, max_shift=8.0, max_rotation=1.0, shading=0.0)
MARGIN = 8  # px at the frame's edge that the end-point error leaves out: some frames do not see them
CROP, HELD_OUT = (slice(20, 400), slice(60, 580)), (3, 5, 7)
NOISE = 6.0  # counts, of the A65's frames
SHOWN = 150  # counts that are white in a picture of errors
HOMOGRAPHY = "physics.warp.motion=homography"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--prior", action="append", help="of the scene; may be given several times")
    parser.add_argument("--held-out", type=int, action="append", help="frames of the A65 burst")
    parser.add_argument("--panels", type=Path, help="write a picture of the A65's errors here")
    parser.add_argument("--threads", type=int, default=2, help="the machine's, for the seconds")
    parser.add_argument("--output", type=Path, help="write the report to this file too")
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    write(itertools.chain(simulated(options), real(options)), "benchmarks/flow.py", options.output)


def simulated(options: argparse.Namespace) -> Iterator[str]:
    """A row for each burst and prior: aligned PSNR, and mean end-point error in px."""
    yield "| picture | parallax, px | prior | homography, dB | flow, dB | its error, px | flow's, px | seconds |"
    yield "|---|---|---|---|---|---|---|---|"
    for name in PICTURES:
        for parallax in PARALLAX:
            sim = burst(name, parallax)
            for prior in options.prior or PRIORS:
                still = run("nuc", sim.frames, options, HOMOGRAPHY, prior=prior)
                found = run("flow", sim.frames, options, prior=prior)
                flat = displacements(project_pixels(torch.from_numpy(still.motion), CAMERA.shape)).numpy()
                psnr = [scores(each.scene, sim.truth.scene)["psnr_aligned"] for each in (still, found)]
                errors = [end_point_error(each, sim) for each in (flat, found.extra["flow"])]
                yield (
                    f"| {name} | {parallax:g} | {prior} | {psnr[0]:.1f} | **{psnr[1]:.1f}** | {errors[0]:.2f} | "
                    f"**{errors[1]:.3f}** | {found.metrics['seconds']:.1f} |"
                )


def run(problem: str, frames: np.ndarray, options: argparse.Namespace, *more: str, **settings: Any) -> Any:
    return deepir.run(problem, f"threads={options.threads}", *more, frames=frames, **settings)


def burst(name: str, parallax: float) -> Simulation:
    """Six frames of 128 x 160 px in counts, shifts up to 8 px, turns up to 1 degree."""
    settings = Settings(**(vars(CAMERA) | {"parallax": parallax}))
    return simulate(picture(name), settings, seed=SEED)


def end_point_error(flow: np.ndarray, sim: Simulation) -> float:
    """Mean distance from the truth, px, where there is texture: the half with the larger gradients over 7 x 7 px."""
    slopes = sum(each**2 for each in np.gradient(sim.truth.scene))
    texture = ndimage.uniform_filter(slopes, 7)[MARGIN:-MARGIN, MARGIN:-MARGIN]
    beside = (flow - sim.truth.flow)[1:, :, MARGIN:-MARGIN, MARGIN:-MARGIN]
    return float(np.hypot(beside[:, 0], beside[:, 1])[:, texture > np.median(texture)].mean())


def real(options: argparse.Namespace) -> Iterator[str]:
    """A row for each held-out frame: the error of its prediction, in counts."""
    path = Path(os.environ.get("DEEPIR_DATA", "")) / "a65" / "a65_frames_000-009.npz"
    if "DEEPIR_DATA" not in os.environ or not path.is_file():
        yield "(A65: set DEEPIR_DATA to the folder of the data)"
        return
    frames = deepir.read_frames(path).frames[:, *CROP].astype(np.float32)
    motion = register(torch.from_numpy(frames), model="homography").motion
    yield ""
    yield "| A65, held out | homography: rms, bulk | flow: rms, bulk | rms less | seconds |"
    yield "|---|---|---|---|---|"
    for k in options.held_out or HELD_OUT:
        kept = np.delete(frames, k, axis=0)
        still, found = run("nuc", kept, options, HOMOGRAPHY), run("flow", kept, options)
        errors = [prediction_error(result, frames, motion, k, dense=result is found) for result in (still, found)]
        scored = held_out(kept.shape[1:]).numpy() & np.isfinite(errors).all(0)  # the same for both
        flat, dense = (spread(each[scored]) for each in errors)
        if options.panels:
            panels = [("homography", errors[0], -SHOWN, SHOWN), ("flow", errors[1], -SHOWN, SHOWN)]
            low, high = np.percentile(frames[k], [1, 99])
            write_panels(options.panels, [(f"A65, frame {k}", frames[k], low, high), *panels])
        yield (
            f"| frame {k} | {flat.rms:.1f}, {flat.bulk:.1f} | {dense.rms:.1f}, {dense.bulk:.1f} | "
            f"**{100 * (1 - dense.rms / flat.rms):.0f} %** | {found.metrics['seconds']:.0f} |"
        )


def spread(error: np.ndarray) -> SimpleNamespace:
    """Standard deviation, `rms`, and that of the bulk."""
    bulk = 1.4826 * float(np.median(np.abs(error - np.median(error))))
    return SimpleNamespace(rms=float(error.std()), bulk=bulk)


def prediction_error(result: Any, frames: np.ndarray, motion: torch.Tensor, k: int, *, dense: bool) -> np.ndarray:
    """Prediction of frame `k` less the frame, (h, w); NaN where there is none.

    Of the samples in `held_out` the motion has seen nothing. Scene and sensor stay; the motion starts where the frame
    registers. Displacements begin, as in the problem, from those of another frame: of the two beside it.
    """
    size = frames.shape[1:]
    scene = ndimage.spline_filter(result.scene.astype(float), order=3, mode="mirror")
    held = held_out(size)
    field: Any = (Flow if dense else Homography)((2, 3, 3), size=size)
    field.init_from(motion[[0, k]])
    maps = {"scene": scene, "gain": result.gain, "offset": result.offset}
    fields = {"motion": field, "level": Pixels((2, 1, 1, 1))} | {name: known(each) for name, each in maps.items()}
    data = torch.from_numpy(frames[[0, k]])[:, None]
    operator = Chain({"warp": Warp(size, size, (0, 0)), "sensor": Sensor()})
    problem = Problem(operator, fields, data, torch.full_like(data, NOISE**-2))
    if dense:
        beside = [k - 1, k + 1]
        corrected = torch.from_numpy((frames[[*beside, k]] - result.offset) / result.gain)
        seen = torch.from_numpy(np.broadcast_to(~result.bad_pixels, (4, *size)).copy())
        seen[3] &= ~held
        start = Flow((4, 3, 3), size=size)
        start.init_from(motion[[0, *beside, k]])
        pictures = torch.cat((torch.from_numpy(result.scene)[None], corrected))
        moved = optical_flow(pictures, seen, start)[[0, 3]]
        field.init_from(field.start + moved.permute(0, 2, 3, 1))
    usable = problem.valid(problem.values())[1, 0] & ~torch.from_numpy(result.bad_pixels)
    problem.precision.copy_(usable * NOISE**-2)[0] = 0  # the first frame is the scene
    problem.held_out[1, 0] = held
    step = (Step(("motion", "level")),)
    solve(problem, [Stage(f"{i}", step, 40, prepare=update_noise) for i in range(3)])
    with torch.no_grad():
        error = (problem.predict(problem.values()) - data)[1, 0]
    return np.where(usable, error, np.nan)


def held_out(size: tuple[int, ...]) -> torch.Tensor:
    """Half of the squares of 4 x 4 px, bool (h, w)."""
    chosen = torch.rand(-(-size[0] // 4), -(-size[1] // 4), generator=torch.Generator().manual_seed(0)) < 0.5
    return chosen.repeat_interleave(4, 0).repeat_interleave(4, 1)[: size[0], : size[1]]


def known(value: np.ndarray) -> Constant:
    """A field that does not move."""
    found = Constant((1, 1, *value.shape))
    found.values.copy_(torch.from_numpy(value.astype(np.float32)))
    return found


if __name__ == "__main__":
    main()
