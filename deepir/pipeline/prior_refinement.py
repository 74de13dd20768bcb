"""A prior that is fitted to the scene once the sensor is known.

Networks move the scene's contrast into the gain as total variation does, and take hundreds of iterations where
pixels take tens. So the sensor is found with pixels under total variation, whatever the prior; then another field takes
the pixels' place, with its own penalties, and is fitted to the same data with the sensor fixed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.arrays.windows import fill_nearest
from deepir.assembly import build_scene
from deepir.config import Config
from deepir.config.components import validate
from deepir.config.schema import Fit
from deepir.estimation.prior_weight import is_oversmoothed, reduce_weight, weigh_scene
from deepir.fields.base import Pixels
from deepir.joint_problem import AnyProblem
from deepir.metrics import RegisteredAverage
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.problem import Problem
from deepir.schedule import Stage, Step

LANDWEBER_ITERATIONS = 30
JOINT_TOLERANCE = 0.03  # nats per scene pixel that ten iterations gain, where the sensor follows the scene


class PriorRefinement:
    """Field and penalties of each scene, by a `scene.fit`, and the stages in which they are fitted."""

    def __init__(self, problem: AnyProblem, config: Config) -> None:
        self.fit = Fit(**validate(Fit, config.scene["fit"], "scene.fit"))
        self.from_average = config.scene.get("init", "average") == "average"
        #: By the unknown's name.
        self.scenes = {
            name: build_scene(config.scene, problem.fields[name].shape, shown_by[0].data.device)
            for name, shown_by in problem.scenes.items()
        }
        pixels = all(isinstance(field, Pixels) for field, _ in self.scenes.values())
        together = self.fit.with_sensor and pixels and all(map(has_fourier_model, problem.data_sets))
        cut_off = any(each.saturation is not None for each in problem.data_sets)
        #: Gain and offset, if these follow the scene; where samples are cut off it is not sure enough of itself.
        self.follows = tuple(problem.closed_form()) if together and not cut_off else ()
        frames = min(len(each.data) for each in problem.data_sets)
        self.tolerance = JOINT_TOLERANCE / frames if self.follows else Stage.tolerance

    def after(self, stages: Sequence[Stage], weigh: Callable[[Any], None] = weigh_scene) -> list[Stage]:
        """The stages, and those of the prior; where it is stopped by held-out samples, none before saw them.

        `weigh` sets the weights of its penalties.
        """
        fit, stopped = self.fit, self.fit.average > 0
        before = [dataclasses.replace(s, use_held_out=s.use_held_out and not stopped) for s in stages]
        follow = (Step(self.follows, "eliminate"),) if self.follows else ()
        steps = (Step(tuple(self.scenes), fit.method, fit.lr, average=fit.average), *follow)
        rounds = [f"prior {i + 1}" for i in range(fit.rounds)] if fit.rounds > 1 else ["prior"]
        one = Stage("prior", steps, fit.iterations, weigh, not stopped, bool(follow), self.tolerance)
        mine = [dataclasses.replace(one, name=name) for name in rounds]
        mine[0] = dataclasses.replace(mine[0], change=self.enter)
        if self.follows:
            mine.append(
                dataclasses.replace(mine[-1], name="looser", change=None, prepare=reduce_weight, needed=is_oversmoothed)
            )
        return [*before, *mine]

    @torch.no_grad()
    def enter(self, problem: AnyProblem) -> None:
        """Put the prior's fields in the place of those that found the sensor."""
        for name, (field, penalties) in self.scenes.items():
            average = registered_average(problem.scenes[name][0]) if self.from_average else None
            field.init_from(problem.fields[name]() if average is None else average)
            problem.represent(name, field, penalties)


@torch.no_grad()
def registered_average(problem: Problem) -> Tensor:
    """The scene that the samples show that are not held out, without a prior; all other unknowns as they are.

    The first round averages what the frames show, which the spline blurs; the others give back what is missing
    (Landweber 1951). That converges where an operator's sums do not cancel, as those of a coded aperture of both signs
    do: else the scene stays as it is.
    """
    values: Any = problem.values()
    seen = (problem.fitted() > 0).to(problem.data)
    average = RegisteredAverage(problem, values, seen)
    shown = residual = problem.data - average.at_zero
    least = 0.3 * float(average.weight.max())
    weight, known = average.weight.clamp(min=least), average.weight > least
    scene = fill_nearest(average.backproject(shown) / weight, known)
    for _ in range(LANDWEBER_ITERATIONS):
        residual = problem.data - problem.predict({**values, "scene": scene})
        scene = scene + average.backproject(residual) / weight
    converges = (seen * residual.square()).sum() <= (seen * shown.square()).sum()
    return scene if converges else problem.fields["scene"]()
