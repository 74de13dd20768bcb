"""Super-resolution."""

from __future__ import annotations

import math

from deepir.effects.frame_gain import normalise_frame_gain
from deepir.effects.noise import update_noise
from deepir.effects.reference_level import take_reference_level
from deepir.effects.sensor_pattern import update_strengths
from deepir.estimation.cross_validation import (
    cross_validation_stages,
    start_trials,
    weight_from_cross_validation,
)
from deepir.estimation.penalty_weights import weigh_scene
from deepir.operators import Downsample
from deepir.optim.held_out import hold_out
from deepir.problem import Problem
from deepir.problems.definition import Definition, start_precision, start_scene_and_parts
from deepir.registry import register
from deepir.schedule import Stage, Step

#: Weight of the scene's penalties while the sensor is estimated, to that of the scene's own stage.
WEAK = 0.2


@register("problem", "sr")
class SR(Definition):
    """A scene finer than the detector, gain, offset and motion from a jittered burst.

    As in `nuc`, the sensor is estimated under a weak prior on the scene. The motion is not: with few frames a
    scene so free explains any motion. How strong the prior is to be, held-out samples say.
    """

    frames = 2
    motion = True
    operators = ("warp", "downsample", "sensor")

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and patterns as the raw frames show them; scene: registered average."""
        start_precision(problem)
        start_scene_and_parts(problem)
        hold_out(problem, seed)
        weigh_scene(problem, WEAK)
        start_trials(problem)
        self.messages = few_frames(len(problem.data), factor_of(problem))

    def plan(self, problem: Problem) -> list[Stage]:
        """Sensor and motion by turns, with the search for the scene's weights between; the scene on all samples."""
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = (Step(tuple(name for name in free if name != "motion")),)
        moving = (Step(tuple(name for name in ("scene", "motion") if name in free)),)
        sensor = (*still, Step(closed, "eliminate")) if closed else still
        return [
            Stage("sensor 1", sensor, 40),
            Stage("sensor 2", sensor, 40, prepare=_update_first),
            Stage("motion 1", moving, 20, prepare=weight_from_cross_validation),
            Stage("sensor 3", sensor, 25, prepare=_update),
            *cross_validation_stages(problem),
            Stage("motion 2", moving, 20, prepare=weight_from_cross_validation),
            Stage("sensor 4", sensor, 25, prepare=_update),
            Stage("scene", (Step(("scene",)),), 40, prepare=_finish, use_held_out=True),
        ]


def factor_of(problem: Problem) -> int:
    """How many px of the scene a detector's pixel is wide."""
    stages = [stage for _, stage in problem.operator.named()]
    return math.prod(stage.factor for stage in stages if isinstance(stage, Downsample))


def few_frames(count: int, factor: int) -> list[str]:
    """A line if the frames have fewer samples than the scene has pixels."""
    if count >= factor**2:
        return []
    less = math.isqrt(count)
    return [
        f"{count} frames for factor {factor}: the scene has {factor**2} px for each of the detector's, and each frame "
        "shows one sample of them; fine detail is in part the prior's. "
        f"Take {factor**2} frames{f', or physics.downsample.factor={less}' if less > 1 else ''}"
    ]


def _update_first(problem: Problem) -> None:
    _update(problem)
    if take_reference_level(problem):
        start_scene_and_parts(problem)
        weight_from_cross_validation(problem, WEAK)


def _update(problem: Problem) -> None:
    normalise_frame_gain(problem)
    update_strengths(problem)
    weight_from_cross_validation(problem, WEAK)


def _finish(problem: Problem) -> None:
    normalise_frame_gain(problem)
    update_noise(problem, settled=True)
    weight_from_cross_validation(problem)
