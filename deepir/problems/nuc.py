"""Non-uniformity correction."""

from __future__ import annotations

import torch

from deepir.problem import Problem
from deepir.problems.definition import Definition, start_precision, start_scene
from deepir.registry import register
from deepir.solve import Stage, Step


@register("problem", "nuc")
class NUC(Definition):
    """Scene, gain, offset and motion from a jittered burst."""

    frames = 2
    motion = True

    def initialise(self, problem: Problem, seed: int) -> None:
        start_precision(problem)
        start_scene(problem)

    def plan(self, problem: Problem) -> list[Stage]:
        sensor = (Step(("scene","motion"), "lbfgs"), Step(("gain","offset"), "eliminate"))
        return [Stage("sensor", sensor, 100), Stage("scene", (Step(("scene",), "lbfgs"),), 60)]
