"""Stray flux in front of the sensor."""

from __future__ import annotations

from deepir.problem import Problem
from deepir.problems.definition import start_precision, start_scene
from deepir.problems.nuc import NUC, WEAK
from deepir.registry import register
from deepir.slow_strengths import estimate_slow
from deepir.solve import Stage, Step
from deepir.strengths import hold_out, start_parts, weigh_scene


@register("problem", "narcissus")
class Narcissus(NUC):
    """Scene, stray flux, gain, offset and motion from a jittered burst: the scene moves, the stray flux stays.

    Stray flux first, with a sensor that is taken for even: gain and offset, which follow at once, would take over
    what it has not yet explained.
    """

    frames = 1
    operators = ("warp", "add", "sensor")

    def initialise(self, problem: Problem, seed: int) -> None:
        """As in `nuc`."""
        start_precision(problem)
        start_scene(problem)
        estimate_slow(problem, start=True)
        start_parts(problem)
        hold_out(problem, seed)
        weigh_scene(problem, WEAK)

    def plan(self, problem: Problem) -> list[Stage]:
        """Scene and stray flux; then as in `nuc`."""
        closed = problem.closed_form()
        still = tuple(name for name in problem.free() if name not in closed and name != "motion")
        first, *others = super().plan(problem)
        return [
            Stage("stray", (Step(still), Step(("offset",), "eliminate")), STRAY),
            Stage(first.name, first.steps, first.iterations, prepare=_sensor),
            *others,
        ]


STRAY = 60


def _sensor(problem: Problem) -> None:
    estimate_slow(problem)
    weigh_scene(problem, WEAK)
