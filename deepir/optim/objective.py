"""Objective of a stage, and its optimisers."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from deepir.operators import Warp
from deepir.optim import Optimiser, free_parameters
from deepir.optim.degrees_of_freedom import degrees_of_freedom, is_joint_with_motion
from deepir.optim.preconditioner import make_preconditioner
from deepir.problem import Problem, Values
from deepir.registry import lookup
from deepir.schedule import Stage, Step


def objective(problem: Problem, stage: Stage) -> Callable[[Sequence[str]], tuple[Tensor, Values]]:
    """The stage's objective as a function of which unknowns are free: `free -> (total, values)`."""
    eliminated = [name for step in stage.steps if step.method == "eliminate" for name in step.group]
    group = {name for step in stage.steps for name in step.group}
    moving, size = is_joint_with_motion(problem, group), (problem.data.shape[-2], problem.data.shape[-1])
    precision = problem.precision if stage.use_held_out else problem.fitted()

    active = {name for name in group if name in eliminated or free_parameters(problem, [name])}
    with torch.no_grad():  # once: gain and offset of several parts are not free
        fixed = problem.values(without=active)
        constant_prior = sum(problem.priors(fixed).values(), problem.data.new_zeros((), dtype=torch.float64))

    def evaluate(free: Sequence[str]) -> tuple[Tensor, Values]:
        values = fixed | problem.values(free, without=[*eliminated, *fixed])
        terms = [constant_prior, problem.misfit(values, eliminated, precision)]
        terms += problem.priors({name: values[name] for name in active}, eliminated).values()
        if moving:
            terms.append(degrees_of_freedom(values[problem.slots[problem.slot(Warp, "motion")]], size))
        return torch.stack([term.double() for term in terms]).sum(), values

    return evaluate


def optimisers_of(problem: Problem, stage: Stage) -> list[tuple[Optimiser, Step]]:
    """Optimisers of the steps of a stage that have free parameters, each with its step."""
    evaluate = objective(problem, stage)
    steps = [s for s in stage.steps if s.method != "eliminate" and free_parameters(problem, s.group)]
    found = []
    for step in steps:
        rates = {name: step.rates.get(name, step.lr) for name in step.group}
        optimiser = lookup("optimiser", step.method)(
            problem, step.group, evaluate, lr=rates, average=step.average
        )
        found.append((optimiser, step))
    eliminated = [name for step in stage.steps if step.method == "eliminate" for name in step.group]
    for optimiser, _ in found:
        if optimiser.preconditioned:
            optimiser.preconditioner = make_preconditioner(
                problem, optimiser.parameters, eliminated, high_frequencies_only=stage.fine
            )
    return found
