"""Objective of a stage, and its optimisers."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.joint_problem import AnyProblem
from deepir.operators import Warp
from deepir.optim import Optimiser, free_parameters
from deepir.optim.block_preconditioner import make_block_preconditioner
from deepir.optim.degrees_of_freedom import degrees_of_freedom, is_joint_with_motion
from deepir.problem import Values
from deepir.registry import lookup
from deepir.schedule import Stage, Step


def objective(problem: AnyProblem, stage: Stage) -> Callable[[Sequence[str]], tuple[Tensor, Values]]:
    """The stage's objective as a function of which unknowns are free: `free -> (total, values)`."""
    eliminated = [name for step in stage.steps if step.method == "eliminate" for name in step.group]
    group = {name for step in stage.steps for name in step.group}
    moving = _joint_motions(problem, group)
    precision: Any = problem.precision if stage.use_held_out else problem.fitted()

    active = {name for name in group if name in eliminated or free_parameters(problem, [name])}
    with torch.no_grad():  # once: gain and offset of several parts are not free
        fixed = problem.values(without=active)
        zero = problem.data_sets[0].data.new_zeros((), dtype=torch.float64)
        constant_prior = sum(problem.priors(fixed).values(), zero)

    def evaluate(free: Sequence[str]) -> tuple[Tensor, Values]:
        values = fixed | problem.values(free, without=[*eliminated, *fixed])
        terms = [constant_prior, problem.misfit(values, eliminated, precision)]
        terms += problem.priors({name: values[name] for name in active}, eliminated).values()
        terms += [degrees_of_freedom(values[name], size) for name, size in moving.items()]
        return torch.stack([term.double() for term in terms]).sum(), values

    return evaluate


def _joint_motions(problem: AnyProblem, group: Collection[str]) -> dict[str, tuple[int, int]]:
    """Motions that are fitted jointly with the scene they move in, and the sizes of their frames."""
    found = {}
    for each in problem.data_sets:
        names = problem.names_in(each)
        if is_joint_with_motion(each, [own for own, name in names.items() if name in group]):
            name = names[each.slots[each.slot(Warp, "motion")]]
            found[name] = (each.data.shape[-2], each.data.shape[-1])
    return found


def optimisers_of(problem: AnyProblem, stage: Stage) -> list[tuple[Optimiser, Step]]:
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
            optimiser.preconditioner = make_block_preconditioner(
                problem, optimiser.parameters, eliminated, high_frequencies_only=stage.fine
            )
    return found
