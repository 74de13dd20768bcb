"""Dense motion on top of a homography."""

from __future__ import annotations

import torch

from deepir.curvature import modelled
from deepir.optical_flow import optical_flow
from deepir.problem import Problem
from deepir.problems.nuc import NUC, WEAK
from deepir.registry import register
from deepir.solve import Stage, Step
from deepir.strengths import keep_gauge, update_noise, update_parts, weigh_scene


@register("problem", "flow")
class FlowProblem(NUC):
    """Scene, sensor and a dense motion: for parallax, and scenes that are not rigid.

    First the sensor, as in `nuc`, at the registered homographies. Frames without its pattern then show how each is
    displaced from the first, and all is estimated anew from there, the displacements together with scene and sensor.
    """

    def initialise(self, problem: Problem, seed: int) -> None:
        """As for `nuc`."""
        super().initialise(problem, seed)
        self.seed = seed

    def plan(self, problem: Problem) -> list[Stage]:
        """A round at the homographies, three with displacements; then the scene on all samples."""
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name != "motion")
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, last = (8, 20) if modelled(problem) else (25, 35)
        return [
            Stage("homography", (Step(still), *eliminate), short),
            Stage("flow 1", (Step(free), *eliminate), 25, prepare=self._displace),
            Stage("flow 2", (Step(free), *eliminate), 25, prepare=_update),
            Stage("flow 3", (Step(free), *eliminate), 30, prepare=_update),
            Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True),
        ]

    def _displace(self, problem: Problem) -> None:
        """Start again, at displacements that the frames show."""
        _update(problem)
        with torch.no_grad():
            values = problem.values()
            corrected = (problem.data - values["offset"] - values["level"]) / values["gain"]
        motion = problem.fields["motion"]
        beside = optical_flow(corrected[:, 0], problem.precision[:, 0] > 0, motion)
        motion.init_from(motion.start + beside.permute(0, 2, 3, 1))
        for name in problem.closed_form():
            field = problem.fields[name]
            field.init_from(torch.full(field.shape, field.neutral))
        super().initialise(problem, self.seed)


def _update(problem: Problem) -> None:
    update_noise(problem)
    keep_gauge(problem)
    update_parts(problem)
    weigh_scene(problem, WEAK)


def _finish(problem: Problem) -> None:
    update_noise(problem, settled=True)
    weigh_scene(problem)
