"""Several data sets solved as one problem: registered, built, started, solved."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.assembly import FIRST, build_data_sets, data_sets
from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import DataError
from deepir.joint_problem import JointProblem
from deepir.operators.motion_models import Geometry, homographies
from deepir.optim.objective import Checkpoint, has_held_out, hold_out
from deepir.optim.solve import Solution, solve
from deepir.pipeline.collect import make_result, within
from deepir.pipeline.posterior_samples import sampled_uncertainty
from deepir.pipeline.register import frames_of_burst, motion_model, register_frames
from deepir.pipeline.schedule import given_noise, make_recipe, network_message, plan
from deepir.problem import Problem
from deepir.problems.recipe import Recipe
from deepir.registration import register
from deepir.result import Result


def solve_data_sets(
    burst: Burst, config: Config, *, callbacks: Sequence[Any] = (), checkpoint: Checkpoint | None = None
) -> Result:
    """The result of the first data set; what the others have of their own is in `extra`, by its unknown's name."""
    recipe = make_recipe(config)
    motions: dict[str, Tensor | None] = {}
    kept, messages, used = {}, [], {}
    for name, own, frames in data_sets(config, burst):
        motion, used[name], found = register_frames(frames, own, recipe)
        motions[name] = None if motion is None else motion[used[name]]
        kept[name] = frames_of_burst(frames, used[name])
        messages += found if name == FIRST else [within(line, f"data set '{name}'") for line in found]
    others = {name: each for name, each in kept.items() if name != FIRST}
    several = dataclasses.replace(kept[FIRST], datasets=others)

    def built() -> tuple[JointProblem, dict[str, Geometry]]:
        problems, places = build_data_sets(config, several, motions)
        for name, own, _ in data_sets(config, several):
            given_noise(problems[name].to(config.device), own)
        return recipe.join(problems, config.seed), places

    problem, places = built()
    if relative := relative_motions(problem, config, several):
        for name, motion in relative.items():
            motions[name] = motion if (before := motions[name]) is None else motion @ before
        problem, places = built()
    for each in problem.data_sets[1:]:
        if problem.names_in(each)["scene"] == "scene":
            start_radiometry(each)
    frames_used, place = used[FIRST], places.pop(FIRST)

    def collect(solution: Solution) -> Result:
        result = make_result(problem.first, place, solution, burst, frames_used, frames_used, list(messages), math.nan)
        for name, each in places.items():
            add_unknowns(result, problem, name, each)
        return result

    return solve_jointly(problem, recipe, config, callbacks, checkpoint, collect)


def solve_jointly(
    problem: JointProblem,
    recipe: Recipe,
    config: Config,
    callbacks: Sequence[Any],
    checkpoint: Checkpoint | None,
    collect: Callable[[Solution], Result],
) -> Result:
    """Run the plan of a problem that is started; `collect` makes the result of a solution."""
    stages = plan(problem, recipe, config)
    if config.scene.get("fit") and not has_held_out(problem):
        hold_out(problem, config.seed)
    messages = list(network_message(problem, stages))
    solution = solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint)
    messages += recipe.warnings(problem, complete=config.solver.max_iterations is None)
    result = collect(solution)
    result.messages = list(dict.fromkeys([*result.messages, *messages]))
    result.uncertainty |= sampled_uncertainty(problem, stages[-1], config, callbacks, collect)
    return result


@torch.no_grad()
def relative_motions(problem: JointProblem, config: Config, burst: Burst) -> dict[str, Tensor]:
    """Where frame 0 of each further data set lies in a scene that it shares, (1, 3, 3), px of its detector.

    Its frame is registered with what it would see of the scene as the first data set shows it, unless its motion
    starts elsewhere.

    Raises:
        DataError: A frame does not register.
    """
    found = {}
    for each, (name, own, frames) in zip(problem.data_sets, data_sets(config, burst), strict=True):
        model = motion_model(own)
        if name == FIRST or model is None or problem.names_in(each)["scene"] != "scene":
            continue
        seen = torch.cat([each.predict(each.values())[:1], each.data[:1]])[:, 0].cpu()
        seen = (seen - seen.mean((1, 2), keepdim=True)) / seen.std((1, 2), keepdim=True)  # of other units
        pair = register(seen, model=model, ignore=torch.from_numpy(frames.bad_pixels))
        if not pair.used.all():
            raise DataError(
                f"datasets.{name}: its first frame does not register with the scene of the first data set: give its "
                "motion's init, or scene: own if it shows another scene"
            )
        found[name] = pair.motion[1:]
    return found


@torch.no_grad()
def start_radiometry(data_set: Problem) -> None:
    """Start gain and offset of a camera in units of its own by least squares of its data on the scene's flux.

    Those that have parts about one and zero stay there: they are in the units of the scene.
    """
    fields = [data_set.fields[name] for name in data_set.gain_and_offset()]
    free = [field for field in fields if not field.parts() and any(p.requires_grad for p in field.parameters())]
    if len(free) < 2:
        return
    used = data_set.precision > 0
    flux = data_set.flux(data_set.values())[used].double()
    data = data_set.data[used].double()
    slope = ((flux - flux.mean()) * (data - data.mean())).mean() / flux.var(correction=0)
    for field, value in zip(fields, (slope, data.mean() - slope * flux.mean()), strict=True):
        field.init_from(value.to(data_set.data).expand(field.shape))


@torch.no_grad()
def add_unknowns(result: Result, problem: JointProblem, name: str, place: Geometry) -> None:
    """Add a further data set's own unknowns to `extra`; its scene lies on the grid of its frame 0."""
    each: Any = problem.others[name]
    values = each.values()
    for own, known in problem.names_in(each).items():
        if not known.startswith(f"{name}_"):
            continue
        value = values[own]
        if own == "scene":
            found = place.crop(each.operator.to_pixels(value))
        elif own == each.motion_unknown():
            found = homographies(value)
        else:
            found = value.squeeze()
        result.extra[known] = found.cpu().numpy()
