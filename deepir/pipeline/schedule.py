"""The stages that a problem is solved in, checked against its unknowns."""

from __future__ import annotations

import dataclasses

from deepir.config import Config
from deepir.errors import ConfigError, nearest
from deepir.joint_problem import AnyProblem
from deepir.messages import Message
from deepir.pipeline.prior_refinement import PriorRefinement
from deepir.problems.recipe import Recipe
from deepir.registry import lookup
from deepir.schedule import Stage, Step


def plan(problem: AnyProblem, recipe: Recipe, config: Config) -> list[Stage]:
    """The stages of `solver.plan`, or else the problem's own; `ConfigError` where they do not fit the unknowns."""
    given, cap = config.solver.plan, config.solver.max_iterations
    refinement = PriorRefinement(problem, config) if config.scene.get("fit") else None
    if given is None:
        stages: list[Stage] = recipe.plan(problem)
        where = f"problem '{config.problem}' (or take problem=generic)"
    else:
        where = "solver.plan"
        stages = [
            Stage(
                s.name,
                tuple(Step(**p.model_dump() | {"group": tuple(p.group)}) for p in s.steps),
                s.iterations,
            )
            for s in given
        ]
    if refinement is not None:
        recipe.sensor_follows = bool(refinement.follows)
        stages = refinement.after(stages, recipe.weigh_prior)
    for stage in stages:
        _check_groups(problem, stage, f"{where}, stage '{stage.name}'")
    return [
        dataclasses.replace(s, iterations=min(s.iterations, s.iterations if cap is None else cap))
        for s in stages
    ]


def network_message(problem: AnyProblem, stages: list[Stage]) -> list[str]:
    """A line if a network draws the scene and moves by L-BFGS together with the sensor, for lack of `scene.fit`."""
    moved = {
        name for stage in stages for step in stage.steps if step.method == "lbfgs" for name in step.group
    }
    scene = next((problem.fields[name] for name in problem.scenes if name in moved), None)
    if scene is None or not scene.is_network:
        return []
    return [
        Message(
            "network-without-fit",
            f"scene: '{type(scene).__name__.lower()}' is a network, and moves by L-BFGS together with all others, "
            "which mostly leaves much of the scene's contrast in the gain: fit it once the sensor is known, with "
            "scene.fit.method=adam scene.fit.lr=0.003 scene.fit.iterations=500",
        )
    ]


def _check_groups(problem: AnyProblem, stage: Stage, where: str) -> None:
    if all(step.method == "eliminate" for step in stage.steps):
        raise ConfigError(f"{where}: a stage needs a step that is not 'eliminate'")
    for step in stage.steps:
        if step.method != "eliminate":
            lookup("optimiser", step.method, f"{where}: method")
        if unknown := set(step.rates) - set(step.group):
            other = unknown.pop()
            raise ConfigError(f"{where}: rates: no '{other}' in the group; {nearest(other, step.group)}")
        for name in step.group:
            if name not in problem.fields:
                raise ConfigError(f"{where}: no unknown '{name}'; {nearest(name, problem.fields)}")
            if step.method == "eliminate" and name not in problem.closed_form():
                raise ConfigError(
                    f"{where}: '{name}' has no closed form; {nearest(name, problem.closed_form())}"
                )
