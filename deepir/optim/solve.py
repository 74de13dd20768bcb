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
from deepir.optim import Optimiser
from deepir.optim.active_set import activate_bounds, deactivate_bounds
from deepir.optim.held_out import held_out_error
from deepir.optim.objective import objective, optimisers_of
from deepir.optim.position import Checkpoint, Position, keep, restore
from deepir.problem import Problem, Values
from deepir.schedule import Stage, Step

#: A solve has diverged whose objective is so many times what its stage began with (or a nat a sample).
RISE = 1e3
WATCHED = 25  # iterations from one look at the held-out samples to the next


@dataclass
class Progress:
    """Where a solve is: handed to callbacks after every iteration."""

    stage: str
    iteration: int  # in this stage
    iterations: int  # at most, in this stage
    done: float  # fraction of the plan's iterations
    loss: float
    evaluations: int  # of the objective, in all
    held_out: Callable[[], float]  # root mean square error at the held-out samples; NaN without


@dataclass
class Solution:
    """What a solve found, and why it ended; `history` has one row an iteration."""

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
    problem: Problem,
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
    at, optimisers, saved, reason = Position(), None, time.monotonic(), "converged"

    def save(*, now: bool = False) -> None:
        nonlocal saved
        if checkpoint is not None and (now or time.monotonic() - saved > every):
            keep(problem, optimisers or [], at, checkpoint)
            saved = time.monotonic()

    if checkpoint is not None and checkpoint.exists():
        at, optimisers = restore(problem, plan, checkpoint)
    while at.stage < len(plan):
        stage = plan[at.stage]
        if optimisers is None:
            if stage.needed is not None and not stage.needed(problem):
                at.stage += 1
                continue
            if stage.change is not None:
                stage.change(problem)
            if stage.prepare is not None:
                stage.prepare(problem)
            activate_bounds(problem)
            optimisers = optimisers_of(problem, stage)
        reason = _run(problem, plan, optimisers, at, callbacks, save)
        for optimiser, _ in optimisers:
            optimiser.finish()
        if any(step.method == "eliminate" for step in stage.steps):
            with torch.no_grad():
                objective(problem, stage)(())  # they follow the others' last step
        if at.iteration and not stage.use_held_out and problem.held_out.any():
            at.history[-1]["held_out"] = held_out_error(problem)
        deactivate_bounds(problem)
        at.stage, at.iteration, optimisers = at.stage + 1, 0, None
    with torch.no_grad():
        values = problem.values()
    return Solution(values, reason, at.total, at.evaluations, at.history)


def _run(
    problem: Problem,
    plan: Sequence[Stage],
    optimisers: list[tuple[Optimiser, Step]],
    at: Position,
    callbacks: Sequence[Callable[[Progress], None]],
    save: Callable[..., None],
) -> str:
    """Iterate to the end of the stage; why it ended."""
    stage = plan[at.stage]
    start = [parameter.detach().clone() for parameter in problem.parameters()]
    while at.iteration < stage.iterations:
        # Asked here and not below, so that a resumed solve asks it too.
        if not optimisers or _rests(at, stage, problem):
            return "converged"
        _iterate(problem, stage, optimisers, at)
        try:
            _check(problem, start, stage, at)
            for callback in callbacks:
                callback(_report(problem, plan, stage, at))
        except BaseException:
            save(now=True)
            raise
        save()
        if all(o.done for o, _ in optimisers):
            return "converged"
    return "stopped as planned"


def _iterate(problem: Problem, stage: Stage, optimisers: list[tuple[Optimiser, Step]], at: Position) -> None:
    """One step of each group, and its row of the history."""
    alternate = len(optimisers) > 1
    loss = at.history[-1]["loss"] if at.iteration else math.nan
    for optimiser, step in optimisers:
        if at.iteration % step.every == 0:
            optimiser.step(fresh=alternate)
            loss = optimiser.value
    at.iteration, at.total = at.iteration + 1, at.total + 1
    at.evaluations += sum(o.take_count() for o, _ in optimisers)
    row = {"stage": stage.name, "iteration": at.iteration, "loss": loss}
    if at.iteration % WATCHED == 0 and not stage.use_held_out and problem.held_out.any():
        row["held_out"] = held_out_error(problem)
    at.history.append(row)


def _rests(at: Position, stage: Stage, problem: Problem) -> bool:
    """Whether the last ten iterations gained next to nothing; Adam, whose steps go up and down, takes them all."""
    if at.iteration <= 10 or any(step.method == "adam" for step in stage.steps):
        return False
    losses = [row["loss"] for row in at.history[-at.iteration :]]
    return min(losses[:-10]) - min(losses[-10:]) < stage.tolerance * problem.data.numel()


def _report(problem: Problem, plan: Sequence[Stage], stage: Stage, at: Position) -> Progress:
    loss = at.history[-1]["loss"]
    before = sum(each.iterations for each in plan[: at.stage])
    done = (before + at.iteration) / max(sum(each.iterations for each in plan), 1)
    return Progress(
        stage.name,
        at.iteration,
        stage.iterations,
        done,
        loss,
        at.evaluations,
        lambda: math.nan if stage.use_held_out else held_out_error(problem),
    )


@torch.no_grad()
def _check(problem: Problem, start: Sequence[Tensor], stage: Stage, at: Position) -> None:
    """Raise `SolverError` if the solve is lost; one that only rose goes back to where it began."""
    first, last = at.history[-at.iteration]["loss"], at.history[-1]["loss"]
    if math.isfinite(last) and last <= RISE * max(abs(first), problem.data.numel()):
        return
    if math.isfinite(last):
        for parameter, value in zip(problem.parameters(), start, strict=True):
            parameter.copy_(value)
    what = "is not a number" if not math.isfinite(last) else f"rose from {first:.3g} to {last:.3g}"
    raise SolverError(
        f"the objective {what} at iteration {at.iteration} of stage '{stage.name}': the solve diverged. "
        "The last good state is kept. Check the data's range, the penalties' weights, or lower the step (lr)."
    )
