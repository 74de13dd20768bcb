"""Base class of optimisers of the parameters of a group of fields."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import GaussianField
from deepir.joint_problem import AnyProblem
from deepir.optim.preconditioner import BlockPreconditioner, Preconditioner
from deepir.problem import Values

Evaluate = Callable[[Sequence[str]], tuple[Tensor, Values]]
Rate = float | Mapping[str, float]  # learning rate: one number, or one for each unknown


def free_parameters(problem: AnyProblem, group: Sequence[str]) -> list[nn.Parameter]:
    """Trainable parameters of the fields of a group and of their penalties; not those of fields with zero sigma."""
    penalties = problem.penalties
    fields = [module for name in group for module in problem.fields[name].modules()]
    inactive = {id(p) for f in fields if isinstance(f, GaussianField) and not f.sigma > 0 for p in f.parameters()}
    mine = [p for name in group for p in problem.fields[name].parameters() if id(p) not in inactive]
    mine += [p for name in group if name in penalties for p in penalties[name].parameters()]  # type: ignore[attr-defined]
    return [p for p in mine if p.requires_grad and p.numel()]


class Optimiser:
    """Minimise `evaluate(group) -> (loss, values)` over the parameters of the group's fields.

    `@register("optimiser", NAME)` on a subclass makes it the `method` of a step.
    """

    descends: ClassVar[bool] = True  # whether its objective only falls, so that a stage may end once it rests
    #: Whether it is given the problem's approximate inverse Hessian, where there is one.
    preconditioned: ClassVar[bool] = False

    def __init__(
        self, problem: AnyProblem, group: Sequence[str], evaluate: Evaluate, *, lr: Rate, average: float = 0.0
    ) -> None:
        self.problem, self.average = problem, average
        self.group, self.evaluate, self.lr = tuple(group), evaluate, lr
        self.parameters = free_parameters(problem, group)
        self.value, self.done, self._count = float("nan"), False, 0
        #: Approximate inverse Hessian, for optimisers that use one.
        self.preconditioner: Preconditioner | BlockPreconditioner | None = None

    def step(self, *, fresh: bool) -> None:
        """One iteration; sets `value`, and `done` on convergence. `fresh`: other unknowns changed since the last."""
        raise NotImplementedError

    def finish(self) -> None:
        """Set the parameters to the result of the stage."""

    def state(self) -> dict[str, Tensor]:
        """State, besides the parameters, that a resumed run needs to take the same steps."""
        raise NotImplementedError

    def load(self, state: dict[str, Tensor]) -> None:
        """Continue from a `state()`."""
        raise NotImplementedError

    def gradient(self) -> tuple[float, list[Tensor]]:
        """Objective, nats, and its gradient at the present parameters."""
        self._count += 1
        with torch.enable_grad():
            loss, _ = self.evaluate(self.group)
            if not loss.requires_grad:
                return float(loss), [torch.zeros_like(p) for p in self.parameters]
            found = torch.autograd.grad(loss, self.parameters, allow_unused=True)
        return float(loss.detach()), [
            torch.zeros_like(p) if g is None else g for g, p in zip(found, self.parameters, strict=True)
        ]

    def take_count(self) -> int:
        """Evaluations since the last call."""
        count, self._count = self._count, 0
        return count
