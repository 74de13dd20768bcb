"""Dense motion on top of a homography."""

from __future__ import annotations

from functools import partial

from deepir.curvature import modelled
from deepir.problem import Problem
from deepir.problems.nuc import NUC, WEAK
from deepir.registry import register
from deepir.solve import Stage, Step
from deepir.strengths import keep_gauge, update_noise, update_parts, weigh_scene

COARSER = (4, 2, 1)  # spacings of the control points, in those of the field


@register("problem", "flow")
class FlowProblem(NUC):
    """Scene, sensor and a dense motion: for parallax, and scenes that are not rigid.

    The sensor first as in `nuc`, at the registered homographies. Then the displacements on grids that become finer,
    together with scene and sensor.
    """

    def plan(self, problem: Problem) -> list[Stage]:
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name != "motion")
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, last = (8, 20) if modelled(problem) else (25, 35)
        spacing = problem.fields["motion"].spacing
        return [
            Stage("sensor 1", (Step(still), *eliminate), short),
            Stage("sensor 2", (Step(still), *eliminate), short, prepare=_update),
            *(
                Stage(f"flow {i}", (Step(free), *eliminate), 25, prepare=_update,
                change=partial(_respace, spacing=times * spacing))
                for i, times in enumerate(COARSER, 1)
            ),
            Stage("sensor 3", (Step(free), *eliminate), 25, prepare=_update),
            Stage("scene", (Step(("scene",)),), last, prepare=_finish, use_held_out=True),
        ]


def _respace(problem: Problem, spacing: float) -> None:
    problem.fields["motion"] = problem.fields["motion"].respaced(spacing)


def _update(problem: Problem) -> None:
    update_noise(problem)
    keep_gauge(problem)
    update_parts(problem)
    weigh_scene(problem, WEAK)


def _finish(problem: Problem) -> None:
    update_noise(problem, settled=True)
    weigh_scene(problem)
