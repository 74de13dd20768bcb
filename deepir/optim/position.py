"""Position of a solve in its plan, and its saved state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Protocol

from torch import Tensor

from deepir.errors import DataError
from deepir.joint_problem import AnyProblem
from deepir.optim import Optimiser
from deepir.optim.objective import optimisers_of
from deepir.schedule import Stage, Step


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
    tensors = {f"problem.{name}": value for name, value in _state(problem).items()}
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
        raise DataError(
            f"{checkpoint}: the state of another problem ({error}); delete it to start again"
        ) from error
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


def _state(problem: AnyProblem) -> Mapping[str, Tensor]:
    """Parameters and buffers; the data, which a resumed run reads again, only if they have changed on the way."""
    kept = problem.state_dict().items()
    changed = any(bool((each.contrast != 1).any()) or bool(each.reference != 0) for each in problem.data_sets)
    return {name: value.detach() for name, value in kept if changed or not _is_data(name)}


def _is_data(name: str) -> bool:
    return name.rpartition(".")[2] == "data"
