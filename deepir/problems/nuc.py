"""Non-uniformity correction."""

from __future__ import annotations

from typing import ClassVar

from deepir.curvature import modelled
from deepir.problem import Problem
from deepir.problems.definition import Definition, start_precision, start_scene_and_parts
from deepir.registry import register
from deepir.slow_strengths import estimate_slow
from deepir.solve import Stage, Step
from deepir.strengths import (
    hold_out,
    measure_roughness,
    update_noise,
    update_strengths,
    weigh_scene,
)

#: Weight of the scene's penalties while the sensor is estimated, to that of the scene's own stage.
WEAK = 0.05


@register("problem", "nuc")
class NUC(Definition):
    """Scene, gain, offset and motion from a jittered burst.

    First the sensor, under a weak prior on the scene: with total variation at its proper scale
    the joint optimum is biased, for it pays to shrink the scene's contrast into the gain. Then the scene, with the
    sensor fixed. Strengths are estimated between the rounds.
    """

    frames = 2
    motion = True
    operators: ClassVar[tuple[str, ...]] = ("warp", "sensor")
    #: Unknowns that are refined last: what registration knows of them is good enough to find the sensor.
    late: ClassVar[tuple[str, ...]] = ("motion",)

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and patterns as the raw frames show them; scene: registered average."""
        start_precision(problem)
        start_scene_and_parts(problem)
        estimate_slow(problem, start=True)
        hold_out(problem, seed)
        weigh_scene(problem, WEAK)

    def plan(self, problem: Problem) -> list[Stage]:
        """Three rounds for the sensor, in the last of which the motion is refined; then the scene on all samples.

        Where the curvature is modelled the first ones need fewer iterations, and the last can be had to its end.
        """
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name not in self.late)
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, long, last = (8, 60, 20) if modelled(problem) else (25, 30, 35)
        return [
            Stage("sensor 1", (Step(still), *eliminate), short),
            Stage("sensor 2", (Step(still), *eliminate), short, prepare=update),
            Stage("sensor 3", (Step(free), *eliminate), long, prepare=update),
            Stage("scene", (Step(("scene",)),), last, prepare=finish, use_held_out=True),
        ]


def update(problem: Problem) -> None:
    """Strengths from the last round, for the next."""
    update_strengths(problem)
    weigh_scene(problem, WEAK)


def finish(problem: Problem) -> None:
    """Strengths for the scene's own stage."""
    update_noise(problem, settled=True)
    measure_roughness(problem)
    weigh_scene(problem)
