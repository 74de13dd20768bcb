"""Thermal lag."""

from __future__ import annotations

import numpy as np
import torch

from deepir.operators import Lag
from deepir.problem import Problem
from deepir.problems.definition import start_precision, start_scene
from deepir.problems.nuc import NUC, WEAK, _finish, _update
from deepir.registry import register
from deepir.slow_strengths import estimate_slow
from deepir.solve import Stage, Step
from deepir.strengths import hold_out, start_parts, weigh_scene


@register("problem", "deblur_lag")
class DeblurLag(NUC):
    """Scene, time constant, gain, offset and motion from a burst of a camera that moves smoothly.

    """

    frames = 3
    operators = ("warp", "lag", "sensor")

    def plan(self, problem: Problem) -> list[Stage]:
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name not in ("motion", "tau"))
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, last = (25, 35)
        return [
            Stage("sensor 1", (Step(still), *eliminate), short),
            Stage("sensor 2", (Step(free), *eliminate), 40, prepare=_update),
            Stage("sensor 3", (Step(free), *eliminate), 40, prepare=_update),
            Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True),
        ]
