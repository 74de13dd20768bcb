"""Dense motion on top of a homography."""

from __future__ import annotations

import copy
from typing import Any

import torch

from deepir.effects.effect import Effect
from deepir.effects.reference_level import ReferenceLevel
from deepir.errors import ConfigError
from deepir.fields.dense_motion import Flow
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.problems.optical_flow import optical_flow
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step


@register("problem", "flow")
class DenseMotion(NUC):
    """Scene, sensor and a dense motion: for parallax, and scenes that are not rigid.

    First the sensor, as in `nuc`, at the registered homographies. Frames without its pattern then show how each is
    displaced from the first, and all is estimated anew from there, the displacements together with scene and sensor.
    """

    def initialise(self, problem: Problem, seed: int) -> None:
        """As for `nuc`."""
        self.seed = seed
        super().initialise(problem, seed)

    def plan(self, problem: Problem) -> Schedule:
        """A round at the homographies, three with displacements; then the scene on all samples.

        Raises:
            ConfigError: The motion is no flow, or fixed.
        """
        motion = _name(problem)
        closed = tuple(problem.closed_form())
        free = tuple(name for name in problem.free() if name not in closed)
        still = tuple(name for name in free if name != motion)
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        short, last = (8, 20) if has_fourier_model(problem) else (25, 35)
        stages = [
            Stage("homography", (Step(still), *eliminate), short),
            Stage("flow 1", (Step(free), *eliminate), 25, prepare=self._displace),
            Stage("flow 2", (Step(free), *eliminate), 25, prepare=self.update),
            Stage("flow 3", (Step(free), *eliminate), 30, prepare=self.update),
            Stage("scene", (Step(("scene",)),), last, prepare=self.finish, use_held_out=True),
        ]
        return Schedule(stages)

    def between_rounds(self) -> list[Effect]:
        """Not those that compare frames at one place: displacements explain what moves by itself."""
        return [effect for effect in self.effects if not effect.compares_frames]

    @torch.no_grad()
    def _displace(self, problem: Problem) -> None:
        """Start again, at displacements that the frames show."""
        values = problem.values()
        gain, offset, level = (values[name] for name in problem.sensor_unknowns().values())
        corrected = (problem.data - offset - level) / gain
        flow: Any = problem.fields[_name(problem)]
        with torch.enable_grad():
            moved = optical_flow(
                corrected[:, 0].cpu(), (problem.precision[:, 0] > 0).cpu(), copy.deepcopy(flow).cpu()
            )
        for effect in self.effects:
            if isinstance(effect, ReferenceLevel):
                effect.update(problem, settled=False)
        flow.init_from(flow.start + moved.permute(0, 2, 3, 1).to(flow.start))
        for field in (problem.fields[name] for name in problem.closed_form()):
            field.init_from(torch.full(field.shape, field.neutral).to(corrected))
        problem.precision *= problem.valid(problem.values())
        super().initialise(problem, self.seed)


def _name(problem: Problem) -> str:
    """The unknown that is a dense motion and free."""
    found = [name for name in problem.free() if isinstance(problem.fields[name], Flow)]
    if not found and len(problem.data) > 1:
        raise ConfigError(
            "physics.warp.motion: problem 'flow' estimates a dense motion; take physics.warp.motion=flow, not fixed, "
            "or problem=nuc for one motion of the whole frame"
        )
    return found[0] if found else "motion"
