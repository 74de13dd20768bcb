"""Adam, for networks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from deepir.joint_problem import AnyProblem
from deepir.optim.base import Evaluate, Optimiser, Rate, free_parameters
from deepir.optim.objective import held_out_error
from deepir.registry import register

HELD_OUT_INTERVAL = 10  # iterations between two evaluations of the held-out error


@register("optimiser", "adam")
class Adam(Optimiser):
    """Adam (Kingma and Ba 2015), as torch has it.

    With `average`, what it leaves behind is the exponential average of its iterates with this decay, as it was when it
    predicted the held-out samples best; the last one if none are held out.
    """

    descends = False

    def __init__(
        self, problem: AnyProblem, group: Sequence[str], evaluate: Evaluate, *, lr: Rate, average: float = 0.0
    ) -> None:
        super().__init__(problem, group, evaluate, lr=lr, average=average)
        rates = lr if isinstance(lr, Mapping) else dict.fromkeys(group, lr)
        each = [{"params": free_parameters(problem, [name]), "lr": rates[name]} for name in group]
        self.adam = torch.optim.Adam(each)
        copies = 2 if average else 0
        #: The average, and the best one.
        self.averages = [[p.detach().clone() for p in self.parameters] for _ in range(copies)]
        self.best_error, self.steps = torch.tensor(math.inf, dtype=torch.float64), torch.tensor(0)

    def step(self, *, fresh: bool) -> None:
        """One step; none if value or gradient is not finite."""
        value, gradients = self.gradient()
        finite = math.isfinite(value) and all(bool(g.isfinite().all()) for g in gradients)
        self.value = value if finite else math.nan
        if not finite:
            return
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        self.adam.step()
        self.adam.zero_grad()
        if self.averages:
            self._update_average()

    @torch.no_grad()
    def finish(self) -> None:
        """Set the parameters to the best average."""
        if self.averages:
            self._keep_best_average()
            self._assign(self.averages[1])

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts, averages."""
        found = {
            f"{i}.{name}": value for i, each in self.adam.state_dict()["state"].items() for name, value in each.items()
        }
        for kind, each in zip(("mean", "best"), self.averages, strict=False):
            found |= {f"{kind}.{i}": value for i, value in enumerate(each)}
        return found | {"best_error": self.best_error, "steps": self.steps}

    def load(self, state: dict[str, Tensor]) -> None:
        """Restore a `state()`."""
        whole = self.adam.state_dict()
        for name, value in state.items():
            index, _, key = name.partition(".")
            if index.isdigit():
                whole["state"].setdefault(int(index), {})[key] = value
        self.adam.load_state_dict(whole)
        for kind, each in zip(("mean", "best"), self.averages, strict=False):
            each[:] = [state[f"{kind}.{i}"] for i in range(len(each))]
        self.best_error, self.steps = state["best_error"], state["steps"]

    @torch.no_grad()
    def _update_average(self) -> None:
        self.steps = self.steps + 1
        # At first a plain mean: the start is soon forgotten.
        weight = max(1 - self.average, 1 / int(self.steps))
        for mean, parameter in zip(self.averages[0], self.parameters, strict=True):
            mean.lerp_(parameter, weight)
        if int(self.steps) % HELD_OUT_INTERVAL == 0:
            self._keep_best_average()

    def _keep_best_average(self) -> None:
        """Keep the average if its held-out error is the smallest so far."""
        now = [parameter.detach().clone() for parameter in self.parameters]
        self._assign(self.averages[0])
        error = held_out_error(self.problem)
        self._assign(now)
        if not error >= float(self.best_error):  # the last one, where none are held out
            self.best_error = torch.tensor(error, dtype=torch.float64).nan_to_num(math.inf)
            self.averages[1] = [mean.clone() for mean in self.averages[0]]

    def _assign(self, values: Sequence[Tensor]) -> None:
        for parameter, value in zip(self.parameters, values, strict=True):
            parameter.copy_(value)
