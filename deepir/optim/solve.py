"""Run a plan: a list of stages, each a list of steps over groups of unknowns."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from deepir.errors import SolverError
from deepir.joint_problem import AnyProblem
from deepir.kernels import threads
from deepir.optim import Optimiser
from deepir.optim.objective import (
    Checkpoint,
    Position,
    activate_bounds,
    deactivate_bounds,
    has_held_out,
    held_out_error,
    objective,
    optimisers_of,
    restore_state,
    save_state,
)
from deepir.problem import Values
from deepir.registry import lookup
from deepir.schedule import Stage, Step

#: Objective relative to the start of the stage (at least one nat per sample) from which a solve has diverged.
MAX_OBJECTIVE_RATIO = 1e3
HELD_OUT_REPORT_INTERVAL = 25  # iterations between two evaluations of the held-out error


@dataclass
class Progress:
    """Progress of a solve, passed to callbacks after every iteration."""

    stage: str
    iteration: int  # in this stage
    iterations: int  # at most, in this stage
    done: float  # fraction of the plan's iterations
    loss: float
    evaluations: int  # of the objective, in all
    held_out: Callable[[], float]  # root mean square error at the held-out samples; NaN without


@dataclass
class Solution:
    """Result of a solve; `history` has one row per iteration."""

    values: Values
    reason: str
    iterations: int
    evaluations: int
    history: list[dict[str, Any]] = field(default_factory=list)

    @property
    def held_out(self) -> float:
        """Error at the held-out samples when they were last held out; NaN if none were."""
        return next((row["held_out"] for row in reversed(self.history) if "held_out" in row), math.nan)


def solve(
    problem: AnyProblem,
    plan: Sequence[Stage],
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Checkpoint | None = None,
    every: float = 2.0,
) -> Solution:
    """Minimise `problem.losses` as `plan` says; the problem's fields hold the result.

    Args:
        problem: Its fields' parameters are changed in place.
        plan: Stages, run in order.
        callbacks: Called after each iteration. One that raises stops the solve; the state is saved first.
        checkpoint: Keeps the state: read at the start if it is there, so that an interrupted solve goes on
            with the same steps, and written every `every` seconds.
        every: Seconds between checkpoints.

    Raises:
        SolverError: The objective is not a number, or far above where the stage began. The last good state is
            in the problem, and saved.
    """
    position, optimisers, saved, reason = Position(), None, time.monotonic(), "converged"

    def save(*, now: bool = False) -> None:
        nonlocal saved
        if checkpoint is not None and (now or time.monotonic() - saved > every):
            save_state(problem, optimisers or [], position, checkpoint)
            saved = time.monotonic()

    if checkpoint is not None and checkpoint.exists():
        position, optimisers = restore_state(problem, plan, checkpoint)
    while position.stage < len(plan):
        stage = plan[position.stage]
        if optimisers is None:
            if stage.needed is not None and not stage.needed(problem):
                position.stage += 1
                continue
            if stage.change is not None:
                stage.change(problem)
            if stage.prepare is not None:
                stage.prepare(problem)
            activate_bounds(problem)
            optimisers = optimisers_of(problem, stage)
        free = {name for step in stage.steps for name in step.group}
        with threads.for_layers(any(problem.fields[name].is_network for name in free)):
            reason = _run(problem, plan, optimisers, position, callbacks, save)
        for optimiser, _ in optimisers:
            optimiser.finish()
        if any(step.method == "eliminate" for step in stage.steps):
            with torch.no_grad():
                objective(problem, stage)(())  # they follow the others' last step
        if position.iteration and not stage.use_held_out and has_held_out(problem):
            position.history[-1]["held_out"] = held_out_error(problem)
        deactivate_bounds(problem)
        position.stage, position.iteration, optimisers = position.stage + 1, 0, None
    with torch.no_grad():
        values = problem.values()
    return Solution(values, reason, position.total, position.evaluations, position.history)


def _run(
    problem: AnyProblem,
    plan: Sequence[Stage],
    optimisers: list[tuple[Optimiser, Step]],
    position: Position,
    callbacks: Sequence[Callable[[Progress], None]],
    save: Callable[..., None],
) -> str:
    """Iterate to the end of the stage; returns why it ended."""
    stage = plan[position.stage]
    start = [parameter.detach().clone() for parameter in problem.parameters()]
    while position.iteration < stage.iterations:
        # Asked here and not below, so that a resumed solve asks it too.
        if not optimisers or _has_converged(position, stage, problem):
            return "converged"
        _iterate(problem, stage, optimisers, position)
        try:
            _raise_if_diverged(problem, start, stage, position)
            for callback in callbacks:
                callback(_report(problem, plan, stage, position))
        except BaseException:
            save(now=True)
            raise
        save()
        if all(o.done for o, _ in optimisers):
            return "converged"
    return "stopped as planned"


def _iterate(problem: AnyProblem, stage: Stage, optimisers: list[tuple[Optimiser, Step]], position: Position) -> None:
    """One step of each group, and its row of the history."""
    alternate = len(optimisers) > 1
    loss = position.history[-1]["loss"] if position.iteration else math.nan
    for optimiser, step in optimisers:
        if position.iteration % step.every == 0:
            optimiser.step(fresh=alternate)
            loss = optimiser.value
    position.iteration, position.total = position.iteration + 1, position.total + 1
    position.evaluations += sum(o.take_count() for o, _ in optimisers)
    row = {"stage": stage.name, "iteration": position.iteration, "loss": loss}
    if position.iteration % HELD_OUT_REPORT_INTERVAL == 0 and not stage.use_held_out and has_held_out(problem):
        row["held_out"] = held_out_error(problem)
    position.history.append(row)


def _has_converged(position: Position, stage: Stage, problem: AnyProblem) -> bool:
    """Whether the last ten iterations gained less than the tolerance, if all steps descend, as Adam's do not."""
    methods = {step.method for step in stage.steps} - {"eliminate"}
    if position.iteration <= 10 or not all(lookup("optimiser", each).descends for each in methods):
        return False
    losses = [row["loss"] for row in position.history[-position.iteration :]]
    return min(losses[:-10]) - min(losses[-10:]) < stage.tolerance * _count_samples(problem)


def _report(problem: AnyProblem, plan: Sequence[Stage], stage: Stage, position: Position) -> Progress:
    loss = position.history[-1]["loss"]
    before = sum(each.iterations for each in plan[: position.stage])
    done = (before + position.iteration) / max(sum(each.iterations for each in plan), 1)
    return Progress(
        stage.name,
        position.iteration,
        stage.iterations,
        done,
        loss,
        position.evaluations,
        lambda: math.nan if stage.use_held_out else held_out_error(problem),
    )


def _count_samples(problem: AnyProblem) -> int:
    return sum(each.data.numel() for each in problem.data_sets)


@torch.no_grad()
def _raise_if_diverged(problem: AnyProblem, start: Sequence[Tensor], stage: Stage, position: Position) -> None:
    """Raise `SolverError` on divergence; an objective that only rose is reset to the start of the stage."""
    first, last = position.history[-position.iteration]["loss"], position.history[-1]["loss"]
    if math.isfinite(last) and last <= MAX_OBJECTIVE_RATIO * max(abs(first), _count_samples(problem)):
        return
    if math.isfinite(last):
        for parameter, value in zip(problem.parameters(), start, strict=True):
            parameter.copy_(value)
    what = "is not a number" if not math.isfinite(last) else f"rose from {first:.3g} to {last:.3g}"
    raise SolverError(
        f"the objective {what} at iteration {position.iteration} of stage '{stage.name}': the solve diverged. "
        "The last good state is kept. Check the data's range, the penalties' weights, or lower the step (lr)."
    )
