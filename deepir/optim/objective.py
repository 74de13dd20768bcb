"""The objective of a solve, and held-out samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median_sigma
from deepir.errors import DataError
from deepir.joint_problem import AnyProblem
from deepir.likelihoods import CAUCHY_SCALE
from deepir.optim.base import Optimiser, free_parameters
from deepir.optim.fourier_hessian import degrees_of_freedom, is_joint_with_motion
from deepir.optim.preconditioner import make_block_preconditioner
from deepir.problem import Values
from deepir.registry import lookup
from deepir.schedule import Stage, Step

HELD_OUT_FRACTION = 0.02  # fraction of the samples that is held out
#: Violation of a bound by the prediction from which the sample counts, standard deviations of the noise.
BOUND_VIOLATION = 2.0


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
            found[names[each.motion_unknown()]] = (each.data.shape[-2], each.data.shape[-1])
    return found


def optimisers_of(problem: AnyProblem, stage: Stage) -> list[tuple[Optimiser, Step]]:
    """Optimisers of the steps of a stage that have free parameters, each with its step."""
    evaluate = objective(problem, stage)
    steps = [s for s in stage.steps if s.method != "eliminate" and free_parameters(problem, s.group)]
    found = []
    for step in steps:
        rates = {name: step.rates.get(name, step.lr) for name in step.group}
        optimiser = lookup("optimiser", step.method)(problem, step.group, evaluate, lr=rates, average=step.average)
        found.append((optimiser, step))
    eliminated = [name for step in stage.steps if step.method == "eliminate" for name in step.group]
    for optimiser, _ in found:
        if optimiser.preconditioned:
            optimiser.preconditioner = make_block_preconditioner(
                problem, optimiser.parameters, eliminated, high_frequencies_only=stage.fine
            )
    return found


@torch.no_grad()
def held_out_error(problem: AnyProblem) -> float:
    """Root mean square error at the held-out samples, in the data's units; NaN without any."""
    found = []
    for each in problem.data_sets:
        held = each.held_out & (each.precision > 0)
        if held.any():
            found.append(masked_values(each.predict(each.values()) - each.data, held))
    return float(torch.cat(found).square().mean().sqrt()) if found else math.nan


def has_held_out(problem: AnyProblem) -> bool:
    """Whether any sample is held out."""
    return any(bool(each.held_out.any()) for each in problem.data_sets)


def hold_out(problem: AnyProblem, seed: int, fraction: float = HELD_OUT_FRACTION) -> None:
    """Hold out a random fraction of the samples."""
    generator = torch.Generator().manual_seed(seed)
    for each in problem.data_sets:
        chosen = torch.rand(each.data.shape, generator=generator) < fraction
        each.held_out.copy_(chosen.to(each.held_out.device))


@torch.no_grad()
def deactivate_bounds(problem: AnyProblem) -> None:
    """Give saturated samples zero weight, as estimates of hyperparameters need."""
    for each in problem.data_sets:
        if each.saturation is not None:
            each.precision.masked_fill_(each.saturation != 0, 0)


@torch.no_grad()
def activate_bounds(problem: AnyProblem) -> None:
    """Give weight to saturated samples whose prediction violates the bound by `BOUND_VIOLATION`, and to no others."""
    deactivate_bounds(problem)
    for each in problem.data_sets:
        if each.saturation is None:
            continue
        noise = median_sigma(each.precision)
        short = each.saturation * (each.data - each.predict(each.values())) / noise
        doubt = 1 + (short / CAUCHY_SCALE).square()
        each.precision.add_((short > BOUND_VIOLATION) / (doubt * noise**2))


class Checkpoint(Protocol):
    """Where the state of a solve is kept: tensors, and what fits into JSON. Its `str` names it in messages."""

    def exists(self) -> bool:
        """Whether there is a state to go on from."""

    def save(self, tensors: dict[str, Tensor], position: dict[str, Any]) -> None:
        """Replace the state, whole."""

    def load(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """The state that was saved; `DataError` if it cannot be read."""


@dataclass
class Position:
    """Progress in a plan, and a history with one row per iteration."""

    stage: int = 0
    iteration: int = 0
    evaluations: int = 0
    total: int = 0
    history: list[dict[str, Any]] = field(default_factory=list)


def save_state(
    problem: AnyProblem, optimisers: list[tuple[Optimiser, Step]], position: Position, checkpoint: Checkpoint
) -> None:
    """Save position, unknowns and optimisers to a checkpoint."""
    # The data, which a resumed run reads again, are kept only if they have changed on the way.
    changed = any(bool((each.contrast != 1).any()) or bool(each.reference != 0) for each in problem.data_sets)
    kept = {name: value for name, value in problem.state_dict().items() if changed or not _is_data(name)}
    tensors = {f"problem.{name}": value.detach() for name, value in kept.items()}
    for i, (optimiser, _) in enumerate(optimisers):
        tensors |= {f"optimiser{i}.{name}": value for name, value in optimiser.state().items()}
    checkpoint.save(tensors, asdict(position))


def restore_state(
    problem: AnyProblem, plan: Sequence[Stage], checkpoint: Checkpoint
) -> tuple[Position, list[tuple[Optimiser, Step]] | None]:
    """Put the problem where it was kept: the position and, within a stage, its optimisers.

    Raises:
        DataError: The file is no checkpoint, or of another problem.
    """
    tensors, fields = checkpoint.load()
    try:
        position = _checked(Position(**fields))
        for stage in plan[: position.stage + 1]:
            if stage.change is not None:
                stage.change(problem)
        for name, value in problem.state_dict().items():
            if not _is_data(name) or f"problem.{name}" in tensors:
                value.copy_(tensors[f"problem.{name}"])
        if position.stage >= len(plan):
            return position, None
        optimisers = optimisers_of(problem, plan[position.stage])
        for i, (optimiser, _) in enumerate(optimisers):
            prefix = f"optimiser{i}."
            optimiser.load({n.removeprefix(prefix): v for n, v in tensors.items() if n.startswith(prefix)})
    except (KeyError, TypeError, RuntimeError) as error:
        raise DataError(f"{checkpoint}: the state of another problem ({error}); delete it to start again") from error
    return position, optimisers


def _checked(position: Position) -> Position:
    """The position; `TypeError` if it is none that a solve has."""
    counts = (position.stage, position.iteration, position.evaluations, position.total)
    rows = position.history
    if not all(isinstance(each, int) and each >= 0 for each in counts) or not isinstance(rows, list):
        raise TypeError("a position that no solve has")
    if position.iteration > len(rows) or not all(
        isinstance(row, dict) and isinstance(row.get("loss"), int | float) for row in rows
    ):
        raise TypeError("a history that no solve has")
    return position


def _is_data(name: str) -> bool:
    return name.rpartition(".")[2] == "data"
