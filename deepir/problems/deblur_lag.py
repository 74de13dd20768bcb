"""Thermal lag."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.curvature import modelled
from deepir.operators import Lag
from deepir.problem import Problem
from deepir.problems.nuc import NUC, _finish, _update
from deepir.registry import register
from deepir.solve import Stage, Step


@register("problem", "deblur_lag")
class DeblurLag(NUC):
    """Scene, time constant, gain, offset and motion from a burst of a camera that moves smoothly."""

    frames = 3
    operators = ("warp", "lag", "sensor")

    def initialise(self, problem: Problem, seed: int) -> None:
        start_motion(problem)
        super().initialise(problem, seed)

    def plan(self, problem: Problem) -> list[Stage]:
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name not in ("motion", "tau"))
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, last = (8, 20) if modelled(problem) else (25, 35)
        return [
            Stage("sensor 1", (Step(still), *eliminate), short),
            Stage("sensor 2", (Step(free), *eliminate), 30, prepare=_update),
            Stage("sensor 3", (Step(free), *eliminate), 30, prepare=_update),
            Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True),
        ]


@torch.no_grad()
def start_motion(problem: Problem) -> None:
    """Start the motion where the camera was when a frame was read: what registers lags behind, as its pixels do."""
    name, lag = next((name, each) for name, each in problem.operator.named() if isinstance(each, Lag))
    values = problem.values()
    tau, seen = values[problem.slots[f"{name}.tau"]].double(), values["motion"].double()
    frames = torch.eye(len(seen), dtype=torch.float64)
    late = lag(lag.path.through(frames)[:, None, None], tau=tau.mean()[None,None,None,None])[:, 0, 0]
    problem.fields["motion"].init_from(torch.linalg.solve(late, seen.flatten(1)).view_as(seen))
