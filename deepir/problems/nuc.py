"""Non-uniformity correction."""

from __future__ import annotations

import dataclasses
import functools
import math
from typing import ClassVar

import torch

from deepir.curvature.uncertainty import pattern_cost
from deepir.curvature.unseen import smooth_unseen
from deepir.curvature.waves import modelled
from deepir.evidence.contrast import even_contrast, even_response, response_drifts
from deepir.evidence.reference_level import refine_reference_level, take_reference_level
from deepir.evidence.shaded_gain import estimate_shaded_gain, gain_is_shaded, unknown_shadings
from deepir.evidence.slow_strengths import estimate_slow
from deepir.evidence.strengths import (
    hold_out,
    pattern_to_noise,
    update_strengths,
    weigh_scene,
)
from deepir.evidence.texture import follow_texture
from deepir.evidence.too_smooth import note_misfit
from deepir.joint.bends import bent
from deepir.joint.half_size import halved, take_motion, take_moving
from deepir.joint.step_asked import step_asked
from deepir.noise.lines import with_jumps
from deepir.noise.residual import update_noise
from deepir.outliers.moving import LITTLE, doubt_moving, find_moving
from deepir.problem import Problem
from deepir.problems.definition import Definition, start_precision, start_scene_and_parts
from deepir.registry import register
from deepir.solve import solve
from deepir.stage import Stage, Step

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
        if untouched and step_asked(problem) > ASKED:
            problem.load_state_dict(untouched)
            _take_from_half(problem, seed)
            _start(problem)
        walks = find_moving(problem, settled=False)
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
        short, long, last = (30, 60, 30) if modelled(problem) else (25, 30, 35)
        settled = SETTLED / len(problem.data)
        rough, fine, rest = (ROUGH, FINE, settled) if modelled(problem) else (1e-5, 1e-5, 1e-5)
        first = Stage("sensor 1", (Step(still), *eliminate), short, prepare=smooth_unseen, tolerance=rough)
        third = Stage("sensor 3", (Step(free), *eliminate), long, prepare=_update, tolerance=fine)
        scene = Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True, tolerance=rest)
        shaded = dataclasses.replace(third, name="shaded gain", prepare=_shade, needed=gain_is_shaded)
        return [
            first,
            dataclasses.replace(first, name="sensor 2", prepare=functools.partial(_update, settled=False)),
            third,
            *_response(third),
            *([shaded] if unknown_shadings(problem) else []),
            *with_jumps(problem, scene),
        ]


def _response(last: Stage) -> list[Stage]:
    """More rounds where the last one shows that the camera's response drifts: once more from the start, and on."""
    return [
        dataclasses.replace(last, name=f"response {i}", needed=response_drifts, prepare=prepare)
        for i, prepare in enumerate((_even_response, _go_on_even, _go_on_even), 1)
    ]


@torch.no_grad()
def _start(problem: Problem) -> None:
    """Start without what is known to move by itself."""
    start_precision(problem)
    doubtful = LITTLE * problem.precision * problem.moving
    problem.precision.mul_(~problem.moving)
    start_scene_and_parts(problem)
    estimate_slow(problem, start=True)
    problem.precision.add_(doubtful)
    weigh_scene(problem, WEAK)


def _take_from_half(problem: Problem, seed: int) -> None:
    """Take the motion of a burst, and what moves by itself, from its half."""
    half, definition = halved(problem), NUC()
    definition.initialise(half, seed)
    rounds = definition.plan(half)[:ROUNDS]
    solve(half, rounds)
    take_motion(problem, bent(half, rounds[-1]) or half)
    take_moving(problem, half)


def update(problem: Problem) -> None:
    """Strengths from the last round, for the next."""
    even_contrast(problem)
    update_strengths(problem)
    weigh_scene(problem, WEAK)


def finish(problem: Problem) -> None:
    """Strengths for the scene's own stage."""
    even_contrast(problem)
    update_noise(problem, settled=True)
    weigh_scene(problem)
    cost = 0.0 if problem.follows else pattern_cost(problem, WEAK)
    follow_texture(problem, 0.0 if math.isnan(cost) else cost)


def _update(problem: Problem, *, settled: bool = True) -> None:
    update(problem)
    smooth_unseen(problem)
    striking = doubt_moving(problem, settled=settled) > CLEAR
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
    even_response(problem)
    _start_again(problem)


def _go_on_even(problem: Problem) -> None:
    even_response(problem)
    _update(problem)


def _finish(problem: Problem) -> None:
    finish(problem)
    doubt_moving(problem)
    note_misfit(problem)


def _shade(problem: Problem) -> None:
    _update(problem)
    estimate_shaded_gain(problem)
