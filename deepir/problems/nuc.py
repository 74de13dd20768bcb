"""Non-uniformity correction."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import ClassVar

import torch

from deepir.effects.frame_gain import correct_gain_drift, detect_gain_drift, normalise_frame_gain
from deepir.effects.line_noise import with_jumps
from deepir.effects.moving_objects import LITTLE, detect_moving_objects, down_weight_moving
from deepir.effects.noise import update_noise
from deepir.effects.reference_level import refine_reference_level, take_reference_level
from deepir.effects.sensor_pattern import pattern_to_noise, update_strengths
from deepir.effects.shading import estimate_low_order
from deepir.effects.unobserved import fill_unobserved
from deepir.effects.vignetting import detect_vignetting, estimate_vignetting, unknown_gain_shadings
from deepir.estimation.oversmoothing import store_reference_misfit
from deepir.estimation.penalty_weights import weigh_scene
from deepir.estimation.spatial_weights import adapt_weight_map
from deepir.estimation.uncertainty import nuc_penalty_db
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.optim.held_out import hold_out
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.coarse_to_fine import half_resolution, upsample_motion, upsample_moving_mask
from deepir.problems.definition import Definition, start_precision, start_scene_and_parts
from deepir.problems.homography_selection import select_homography
from deepir.problems.motion_step import gauss_newton_motion_step
from deepir.registry import register
from deepir.schedule import Stage, Step

#: Weight of the scene's penalties while the sensor is estimated, to that of the scene's own stage.
WEAK = 0.05
ROUNDS = 3  # for the sensor
#: px by which the start asks a frame to be moved, from which the half of the burst is asked; that of smaller ones, px,
#: says little.
ASKED, WHOLE = 0.2, 96
#: Strength of the pattern, in standard deviations of the noise, from which it spoils the registration.
BURIED = 10.0
#: Robust standard deviations of what moves by itself, from which it is left out of the start, from which it draws the
#: motion after it before the pattern is known, and scene and pattern once it is.
SHOWN, STRIKING, CLEAR = 12.0, 20.0, 60.0
#: Gain of ten iterations, in nats for each sample, below which a round of the sensor's ends: the first ones, the last.
ROUGH, FINE = 2e-3, 3e-4
#: The same of the scene's own stage, for each of its pixels: dark scenes gain for longer.
SETTLED = 0.1


@register("problem", "nuc")
class NUC(Definition):
    """Scene, gain, offset and motion from a jittered burst.

    First the sensor, under a weak prior on the scene: with total variation at its proper scale
    the joint optimum is biased, for it pays to shrink the scene's contrast into the gain. Then the scene, with the
    sensor fixed. Strengths are estimated between the rounds.
    """

    frames = 2
    judged = True
    motion = True
    weak = WEAK
    operators: ClassVar[tuple[str, ...]] = ("warp", "sensor")
    #: Unknowns that are refined last: what registration knows of them is good enough to find the sensor.
    late: ClassVar[tuple[str, ...]] = ("motion",)
    #: Whether it is not, and none are late.
    buried = False

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and patterns as the raw frames show them; scene: registered average.

        Where that asks for another motion, the burst at half its size is solved first, and tells it. Whoever it shows
        to move by himself is left out of it.
        """
        whole = min(problem.data.shape[-2:]) >= WHOLE and problem.ends is None and not problem.stretched
        untouched = {name: tensor.clone() for name, tensor in problem.state_dict().items()} if whole else {}
        _start(problem)
        if untouched and gauss_newton_motion_step(problem) > ASKED:
            problem.load_state_dict(untouched)
            _take_from_half(problem, seed)
            _start(problem)
        walks = detect_moving_objects(problem, settled=False)
        apart = walks.apart if walks else 0.0
        if walks and apart > SHOWN:
            problem.moving.copy_(walks.samples)
            _start_again(problem)
        hold_out(problem, seed)
        self.buried = apart < STRIKING and pattern_to_noise(problem) >= BURIED

    def plan(self, problem: Problem) -> list[Stage]:
        """Three rounds for the sensor; then the scene on all samples.

        The motion is refined in the last of them, or in all: under a pattern far above the noise it is registered up to
        a px off, and a sensor that was found with that holds it there.

        One more round where what these found tells that the gain is shaded: before, there is as much that looks so.

        Where the curvature is modelled each round ends by itself: in tones there is little left after twenty
        iterations, in counts and where lines are strong after more.
        """
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if self.buried or name not in self.late)
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, long, last = (30, 60, 30) if has_fourier_model(problem) else (25, 30, 35)
        settled = SETTLED / len(problem.data)
        rough, fine, rest = (ROUGH, FINE, settled) if has_fourier_model(problem) else (1e-5, 1e-5, 1e-5)
        first = Stage("sensor 1", (Step(still), *eliminate), short, prepare=fill_unobserved, tolerance=rough)
        third = Stage("sensor 3", (Step(free), *eliminate), long, prepare=_update, tolerance=fine)
        scene = Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True, tolerance=rest)
        shaded = dataclasses.replace(third, name="shaded gain", prepare=_shade, needed=detect_vignetting)
        return [
            first,
            dataclasses.replace(first, name="sensor 2", prepare=functools.partial(_update, settled=False)),
            third,
            *_response(third),
            *([shaded] if unknown_gain_shadings(problem) else []),
            *with_jumps(problem, scene),
        ]


def _response(last: Stage) -> list[Stage]:
    """More rounds where the last one shows that the camera's response drifts: once more from the start, and on."""
    return [
        dataclasses.replace(last, name=f"response {i}", needed=detect_gain_drift, prepare=prepare)
        for i, prepare in enumerate((_even_response, _go_on_even, _go_on_even), 1)
    ]


@torch.no_grad()
def _start(problem: Problem) -> None:
    """Start without what is known to move by itself."""
    start_precision(problem)
    doubtful = LITTLE * problem.precision * problem.moving
    problem.precision.mul_(~problem.moving)
    start_scene_and_parts(problem)
    estimate_low_order(problem, start=True)
    problem.precision.add_(doubtful)
    weigh_scene(problem, WEAK)


def _take_from_half(problem: Problem, seed: int) -> None:
    """Take the motion of a burst, and what moves by itself, from its half."""
    half, definition = half_resolution(problem), NUC()
    definition.initialise(half, seed)
    rounds = definition.plan(half)[:ROUNDS]
    solve(half, rounds)
    upsample_motion(problem, select_homography(half, rounds[-1]) or half)
    upsample_moving_mask(problem, half)


def update(problem: Problem) -> None:
    """Strengths from the last round, for the next."""
    normalise_frame_gain(problem)
    update_strengths(problem)
    weigh_scene(problem, WEAK)


def finish(problem: Problem) -> None:
    """Strengths for the scene's own stage."""
    normalise_frame_gain(problem)
    update_noise(problem, settled=True)
    weigh_scene(problem)
    cost = 0.0 if problem.follows else nuc_penalty_db(problem, WEAK)
    adapt_weight_map(problem, 0.0 if math.isnan(cost) else cost)


def _update(problem: Problem, *, settled: bool = True) -> None:
    update(problem)
    fill_unobserved(problem)
    striking = down_weight_moving(problem, settled=settled) > CLEAR
    if settled:
        refine_reference_level(problem)
    elif take_reference_level(problem) or striking:
        _start_again(problem)


@torch.no_grad()
def _start_again(problem: Problem) -> None:
    """Start again without what moves by itself: it has drawn the scene and the pattern after it, which stay there."""
    for name in problem.closed_form():
        for part in problem.fields[name].parts():
            part.assign(torch.zeros_like(part.values))
            if not part.given:
                part.sigma.zero_()
    _start(problem)


def _even_response(problem: Problem) -> None:
    correct_gain_drift(problem)
    _start_again(problem)


def _go_on_even(problem: Problem) -> None:
    correct_gain_drift(problem)
    _update(problem)


def _finish(problem: Problem) -> None:
    finish(problem)
    down_weight_moving(problem)
    store_reference_misfit(problem)


def _shade(problem: Problem) -> None:
    _update(problem)
    estimate_vignetting(problem)
