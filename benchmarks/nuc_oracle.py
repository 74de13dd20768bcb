"""What can be had of a burst at all: the reconstruction that is told everything but the scene.

It is total variation with deepir's own warp and optimiser, given the true gain, offset, level, motion, noise variance,
bad pixels, moving samples and failed frames, and the weight that is best on the truth.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import Config, load
from deepir.metrics import scores
from deepir.optim.solve import solve
from deepir.problems.initial_estimate import start_scene
from deepir.schedule import Stage, Step
from deepir.simulate import Settings, Simulation, render

VERSION = 2  # to be raised with a change, here or of deepir's warp, that gives other figures
ITERATIONS, TOLERANCE = 100, 1e-6  # 300 iterations change the best PSNR by 0.05 dB at most
STEP = 1.6  # nats: at weight one, a step of so many sigma costs one


def config(settings: Settings) -> Config:
    """Warp, integration over `factor` x `factor` px of the scene, thermal lag if there is one, and a known sensor."""
    integration = {"downsample": {"factor": settings.factor}} if settings.factor > 1 else {}
    lag = {"lag": {"tau": "constant", "readout": settings.readout}} if settings.tau else {}
    physics = {
        "warp": {"motion": {"type": "rigid", "init": "register"}},
        **integration,
        **lag,
        "sensor": {"gain": "constant", "offset": "constant", "level": "constant"},
    }
    return load({"prior": "tv", "physics": physics, "data": {"fps": settings.fps}})


def oracle(sim: Simulation, picture: np.ndarray) -> float:
    """Best PSNR in dB, after one gain and level."""
    return aligned(best_scene(sim, noise_variance(sim, picture)), sim)


def best_scene(sim: Simulation, variance: np.ndarray) -> np.ndarray:
    """The scene (Q h, Q w) of the best PSNR, given the variance of each sample's noise (N, h, w)."""
    truth, used = sim.truth, ~sim.truth.failed
    frames = sim.frames[used].astype(np.float32)
    valid = ~truth.moving[used]
    burst = Burst(frames, valid, truth.bad_pixels)
    problem, geometry = build(config(sim.settings), burst, torch.from_numpy(truth.motion[used]))
    known = {"gain": truth.gain, "offset": truth.offset, "level": truth.level[used, None, None, None]}
    known |= {"tau": truth.tau} if sim.settings.tau else {}
    for name, value in known.items():
        problem.fields[name].values.copy_(torch.from_numpy(value))
    problem.precision.copy_((problem.precision > 0) / torch.from_numpy(variance[used].astype(np.float32))[:, None])
    start_scene(problem)
    penalty = problem.penalties["scene"]["tv"]
    noise = problem.operator.noise_gain * float(problem.precision.sum(0).median().rsqrt())
    natural = 1 / (STEP * noise)
    scenes: dict[float, np.ndarray] = {}  # by their PSNR

    def quality(power: float) -> float:
        penalty.weight.fill_(2**power * natural)
        plan = [Stage("oracle", (Step(("scene",)),), ITERATIONS, tolerance=TOLERANCE)]
        image = problem.operator.to_pixels(solve(problem, plan).values["scene"])
        scene = geometry.crop(image).numpy()
        scenes[found := aligned(scene, sim)] = scene
        return found

    return scenes[climb(quality)]


def climb(quality: Callable[[float], float], reach: int = 5) -> float:
    """Largest value of a function with one peak: in whole steps from 0, then in half steps about the best."""
    found = {0: quality(0)}
    for way in (1, -1):
        at = way
        while abs(at) <= reach and at - way == max(found, key=found.__getitem__):
            found[at] = quality(at)
            at += way
    best = max(found, key=found.__getitem__)
    return max(*found.values(), quality(best + 0.5), quality(best - 0.5))


def noise_variance(sim: Simulation, picture: np.ndarray) -> np.ndarray:
    """The true one of each sample (N, h, w); it is wrong where something moves, and in failed frames."""
    truth, settings = sim.truth, sim.settings
    variance = np.full(sim.frames.shape, truth.read_noise**2 + (1 / 12 if settings.counts else 0))
    if truth.photons_per_unit:
        flux = render(picture, truth.motion, settings.shape, truth.scale, settings.psf_sigma)
        flux = settings.range * flux + (settings.pedestal if settings.counts else 0)
        flux += truth.stray - truth.stray.min()
        variance += truth.gain * np.maximum(flux, 0) / truth.photons_per_unit
    return variance


def reference(sim: Simulation) -> np.ndarray:
    """The true scene, NaN where somebody stands before it in frame 0."""
    factor = sim.settings.factor
    return np.where(sim.truth.moving[0].repeat(factor, 0).repeat(factor, 1), np.nan, sim.truth.scene)


def aligned(scene: np.ndarray, sim: Simulation) -> float:
    """PSNR against the truth after one gain and level."""
    return scores(scene, reference(sim))["psnr_aligned"]


def radiometric(scene: np.ndarray, sim: Simulation) -> float:
    """Root mean square error in % of the range after one level, which no burst shows; the gain stays as it is."""
    error = (scene - reference(sim))[~sim.truth.moving[0]]
    return 100 * float(error.std()) / sim.settings.range
