"""What the motion leaves of a burst: the reconstruction that is told everything but the scene and the sensor's pattern.

It is deepir's own, given the true motion, noise variance, strengths of the sensor's parts, levels, bad pixels, moving
samples and failed frames, as many iterations as it takes, and the weight that is best on the truth. What it is below
the oracle is the price of not knowing the pattern, not of estimating badly.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from nuc_oracle import aligned, climb, noise_variance

from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import load
from deepir.estimation.prior_weight import adapt_weight_map, weigh_scene
from deepir.fields.shading import Shading
from deepir.optim.solve import solve
from deepir.pipeline.schedule import PriorRefinement
from deepir.problem import Problem
from deepir.problems.initial_estimate import start_scene
from deepir.problems.nuc import NUC
from deepir.schedule import Stage, Step
from deepir.simulate import Simulation

VERSION = 5  # to be raised with a change, here or of deepir's solve, that gives other figures
ITERATIONS, TOLERANCE = 300, 1e-7  # of the sensor; the scene has a third of them, at each weight


def told(sim: Simulation, picture: np.ndarray) -> float:
    """Best PSNR in dB, after one gain and level."""
    truth, used = sim.truth, ~sim.truth.failed
    burst = Burst(sim.frames[used].astype(np.float32), ~truth.moving[used], truth.bad_pixels)
    motion = torch.from_numpy(truth.motion[used])
    config = load("nuc", ["physics.sensor.level=constant"])
    problem, geometry = build(config, burst, motion)
    variance = torch.from_numpy(noise_variance(sim, picture)[used].astype(np.float32))[:, None]
    problem.precision.copy_((problem.precision > 0) / variance)
    problem.fields["level"].values.copy_(torch.from_numpy(truth.level[used, None, None, None]))
    start_scene(problem)
    give_strengths(problem, sim)
    weigh_scene(problem, NUC.sensor_weight)
    closed = tuple(problem.closed_form())
    sensor = (Step(("scene",)), Step(closed, "eliminate"))
    solve(problem, [Stage("sensor", sensor, ITERATIONS, tolerance=TOLERANCE)])
    adapt_weight_map(problem)
    contest = PriorRefinement(problem, config)
    contest.enter(problem)
    weigh_scene(problem)
    (penalty,) = problem.penalties["scene"].values()
    natural = float(penalty.weight)

    alone = Stage("scene", (Step(("scene",)),), ITERATIONS // 3, tolerance=10 * TOLERANCE)
    both = (*alone.steps, Step(contest.follows, "eliminate"))
    plan = [alone, dataclasses.replace(alone, name="prior", steps=both, fine=True)]

    def quality(power: float) -> float:
        penalty.weight.fill_(2**power * natural)
        image = problem.operator.to_pixels(solve(problem, plan).values["scene"])
        return aligned(geometry.crop(image).numpy(), sim)

    return climb(quality)


def give_strengths(problem: Problem, sim: Simulation) -> None:
    """Set each part's strength to what the truth's own share of it has: what is smooth first, single pixels last."""
    truth = sim.truth
    for name, true in (("gain", truth.gain), ("offset", truth.offset)):
        rest = torch.from_numpy(np.asarray(true, float).reshape(problem.fields[name].shape))
        rest = rest - rest.mean()
        parts = problem.fields[name].parts()
        for part in sorted(parts, key=lambda part: (not isinstance(part, Shading), -len(part.constant_axes))):
            part.sigma.fill_(1.0)
            part.init_from(rest + part.neutral)
            share = part.values.expand(rest.shape)
            terms = part.relative_sigma.square().sum() if isinstance(part, Shading) else 1
            part.sigma.fill_(float(share.detach().square().mean() / terms) ** 0.5)
            part.whitened.data.zero_()
            rest = rest - share
