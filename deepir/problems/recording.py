"""One sensor from several bursts of a recording."""

from __future__ import annotations

from typing import Any, ClassVar

from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.problems.recipe import each_by_itself
from deepir.registry import register
from deepir.schedule import Schedule


@register("problem", "recording")
class Recording(NUC):
    """Gain and offset from several bursts of a recording; a scene, a motion and levels for each of them.

    Its rounds are those of `nuc`. Each burst takes the first one by itself, so that scenes are near the truth when
    they meet; from then on all bursts share the sensor, see `deepir.joint_problem`.
    """

    several = True
    checked_frames = 8
    effect_names: ClassVar[tuple[str, ...]] = tuple(
        name for name in NUC.effect_names if name not in ("line_noise", "gain_drift", "vignetting")
    )

    def initialise(self, problem: Problem, seed: int) -> None:
        """Also the first round."""
        super().initialise(problem, seed)
        self._first_round(problem)

    def restart(self, problem: Any) -> None:
        """Each burst by itself, the first round included."""
        for each in each_by_itself(problem):
            super().restart(each)
            self._first_round(each)
        self.weigh(problem, self.sensor_weight)

    def _first_round(self, problem: Problem) -> None:
        solve(problem, [super().plan(problem)("sensor 1")])

    def plan(self, problem: Any) -> Schedule:
        """The rounds of `nuc` but the first."""
        return Schedule(super().plan(problem)[1:])
