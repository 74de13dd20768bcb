"""Adam, for networks."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.optimisers.optimiser import Evaluate, Optimiser
from deepir.problem import Problem


class Adam(Optimiser):
    """Adam (Kingma and Ba 2015), as torch has it."""

    def __init__(self, problem: Problem, group: Sequence[str], evaluate: Evaluate, *, lr: float) -> None:
        super().__init__(problem, group, evaluate, lr=lr)
        self.torch = torch.optim.Adam(self.parameters, lr=lr)

    def step(self, *, fresh: bool) -> None:
        """One step; from a value or gradient that is not finite none is taken: the last good state stays."""
        value, gradients = self.gradient()
        finite = math.isfinite(value) and all(bool(g.isfinite().all()) for g in gradients)
        self.value = value if finite else math.nan
        if not finite:
            return
        for parameter, gradient in zip(self.parameters, gradients, strict=True):
            parameter.grad = gradient
        self.torch.step()
        self.torch.zero_grad()

    def state(self) -> dict[str, Tensor]:
        """Moments and step counts."""
        return {
            f"{i}.{name}": value
            for i, each in self.torch.state_dict()["state"].items()
            for name, value in each.items()
        }

    def load(self, state: dict[str, Tensor]) -> None:
        """Take the moments over."""
        whole = self.torch.state_dict()
        for name, value in state.items():
            index, _, key = name.partition(".")
            whole["state"].setdefault(int(index), {})[key] = value
        self.torch.load_state_dict(whole)
