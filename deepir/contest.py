"""A prior that is fitted to the scene once the sensor is known.

Networks move the scene's contrast into the gain as total variation does, and take hundreds of iterations where
pixels take tens. So the sensor is found with pixels under total variation, whatever the prior; then another field takes
the pixels' place, with its own penalties, and is fitted to the same data with the sensor fixed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.build import build_scene
from deepir.components import validate
from deepir.config import Config
from deepir.problem import Problem
from deepir.problems.definition import filled
from deepir.schema import Fit
from deepir.solve import Stage, Step
from deepir.strengths import weigh_scene

SHARPER = 8  # times that the registered average gets back what it does not predict: the spline blurs it


class Contest:
    """The scene's field and penalties of a configuration with `scene.fit`, and the stages in which they are fitted."""

    def __init__(self, problem: Problem, config: Config) -> None:
        self.fit = Fit(**validate(Fit, config.scene["fit"], "scene.fit"))
        self.from_average = config.scene.get("init", "average") == "average"
        field, penalties = build_scene(config.scene, problem.fields["scene"].shape)
        device = problem.data.device
        self.field = field.to(device)
        self.penalties = {name: penalty.to(device) for name, penalty in penalties.items()}

    def after(self, stages: Sequence[Stage]) -> list[Stage]:
        """The stages, and those of the prior; where it is stopped by held-out samples, none before saw them."""
        fit, stopped = self.fit, self.fit.average > 0
        before = [dataclasses.replace(s, use_held_out=s.use_held_out and not stopped) for s in stages]
        step = Step(("scene",), fit.method, fit.lr, average=fit.average)
        rounds = [f"prior {i + 1}" for i in range(fit.rounds)] if fit.rounds > 1 else ["prior"]
        mine = [
            Stage(name, (step,), fit.iterations, prepare=weigh_scene, use_held_out=not stopped)
            for name in rounds
        ]
        mine[0] = dataclasses.replace(mine[0], change=self.enter)
        return [*before, *mine]

    @torch.no_grad()
    def enter(self, problem: Problem) -> None:
        """Put the prior's field in the place of the one that found the sensor."""
        self.field.init_from(self._start(problem))
        problem.represent("scene", self.field, self.penalties)

    def _start(self, problem: Problem) -> Tensor:
        values: Any = problem.values()
        if not self.from_average:
            found: Tensor = values["scene"]
            return found
        average, weight = problem.backproject(values)
        average = filled(average, weight > 0.3 * weight.max())
        for _ in range(SHARPER):
            values["scene"] = average
            slots = {slot: values[name] for slot, name in problem.slots.items()}
            rest = (problem.precision > 0) * (problem.data - problem.predict(values))
            missing = problem.operator.adjoint(rest, tuple(average.shape), **slots)
            average = average + missing / weight.clamp(min=0.3 * float(weight.max()))
        return average
