"""Limited-memory BFGS for nonsmooth objectives, with a state that can be saved."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.joint_problem import AnyProblem
from deepir.optim.base import Evaluate, Optimiser, Rate
from deepir.registry import register

MEMORY = 10  # pairs of steps and gradient changes that are kept
N_RESCALED_PAIRS = 4  # pairs up to which the preconditioner is rescaled to the newest pair
#: Slope at the end of a step, relative to minus that at its start, from which the step was too long.
OVERSHOOT_RATIO = 0.5
OVERSHOOT_SHRINKAGE = 0.7  # factor on the preconditioner after a step that was too long
WOLFE_DECREASE = 1e-4  # constant c1 of the weak Wolfe conditions (Nocedal and Wright, section 3.1)
WOLFE_CURVATURE = 0.9  # constant c2 of the weak Wolfe conditions
MAX_TRIALS = 20  # most trials of a line search


@register("optimiser", "lbfgs")
class LBFGS(Optimiser):
    """Two-loop recursion (Nocedal and Wright, algorithm 7.4), line search of Lewis and Overton (2013).

    Their bracketing for the weak Wolfe conditions needs no smoothness, and mostly takes its first trial. A
    trial whose value or slope is not finite is one that went too far.
    """

    preconditioned = True

    def __init__(
        self, problem: AnyProblem, group: Sequence[str], evaluate: Evaluate, *, lr: Rate, average: float = 0.0
    ) -> None:
        super().__init__(problem, group, evaluate, lr=lr, average=average)
        self.x = self._flat(self.parameters)
        self.gradient_at_x: Tensor | None = None
        self.scale = torch.ones(())  # of a known curvature
        #: Steps, changes of the gradient, and one over their product; the newest last.
        self.pairs: list[tuple[Tensor, Tensor, Tensor]] = []

    def step(self, *, fresh: bool) -> None:
        """One quasi-Newton step. Without descent the memory is dropped; `done` if the gradient has none."""
        if fresh or self.gradient_at_x is None:  # of what a search finds, value and slope are finite
            self.value, self.gradient_at_x = self._at(self.x)
            if not (math.isfinite(self.value) and self.gradient_at_x.isfinite().all()):
                self.value, self.gradient_at_x = math.nan, None
                return
        direction = self._direction(self.gradient_at_x)
        descent = float(torch.dot(self.gradient_at_x, direction))
        if not descent < 0:
            self.pairs.clear()
            direction = -self.gradient_at_x
            descent = float(torch.dot(self.gradient_at_x, direction))
        found = self._search(direction, descent) if descent < 0 else None
        if found is None:
            self.done = not self.pairs
            self.pairs.clear()
            self._at(self.x)  # the eliminated unknowns follow
            return
        x, self.value, slope = found
        s, y = x - self.x, slope - self.gradient_at_x
        if float(torch.dot(s, y)) > 1e-10 * float(y.norm() * s.norm()):
            self.pairs = [*self.pairs, _pair(s, y)][-MEMORY:]
        self.x, self.gradient_at_x = x, slope

    def state(self) -> dict[str, Tensor]:
        """Point, value, gradient and memory."""
        named = {"x": self.x, "value": torch.tensor(self.value, dtype=torch.float64)}
        if self.gradient_at_x is not None:
            named["gradient"] = self.gradient_at_x
        for i, (s, y, _) in enumerate(self.pairs):
            named |= {f"s{i}": s, f"y{i}": y}
        if self.preconditioner is not None:
            named |= {"scale": self.scale}
            named |= {f"preconditioner.{name}": tensor for name, tensor in self.preconditioner.tensors.items()}
        return named

    def load(self, state: dict[str, Tensor]) -> None:
        """Take all of it over."""
        self.x, self.value, self.gradient_at_x = state["x"], float(state["value"]), state.get("gradient")
        if self.preconditioner is not None:
            self.scale = state["scale"]
            self.preconditioner.tensors = {
                name: state[f"preconditioner.{name}"] for name in self.preconditioner.tensors
            }
        self.pairs = [_pair(state[f"s{i}"], state[f"y{i}"]) for i in range(MEMORY) if f"s{i}" in state]

    def _direction(self, slope: Tensor) -> Tensor:
        q = -slope
        if not self.pairs:
            return q if self.preconditioner is None else self.preconditioner.solve(q)
        factors = []
        for s, y, rho in reversed(self.pairs):
            alpha = rho * torch.dot(s, q)
            q.addcmul_(alpha, y, value=-1)
            factors.append(alpha)
        s, y, rho = self.pairs[-1]
        if self.preconditioner is None:
            q.div_(rho * torch.dot(y, y))
        else:
            if len(self.pairs) <= N_RESCALED_PAIRS:
                self.scale = 1 / (rho * torch.dot(y, self.preconditioner.solve(y)))
            q = self.preconditioner.solve(q).mul_(self.scale)
        for (s, y, rho), alpha in zip(self.pairs, reversed(factors), strict=True):
            q.addcmul_(alpha - rho * torch.dot(y, q), s)
        return q

    def _search(self, direction: Tensor, descent: float) -> tuple[Tensor, float, Tensor] | None:
        step = (
            1.0
            if self.pairs or self.preconditioner is not None
            else min(1.0, 1.0 / max(float(direction.abs().max()), 1e-30))
        )
        low, high, best = 0.0, float("inf"), None
        for _ in range(MAX_TRIALS):
            x = torch.add(self.x, direction, alpha=step)
            value, slope = self._at(x)
            along = float(torch.dot(slope, direction))
            if not (value <= self.value + WOLFE_DECREASE * step * descent and math.isfinite(along)):
                high = step
                if best is None:
                    step = _interpolate_step(step, value - self.value, descent)
                    continue
            else:
                best = (x, value, slope)
                if along >= WOLFE_CURVATURE * descent:
                    far = high < float("inf") or along > -OVERSHOOT_RATIO * descent
                    if far and len(self.pairs) >= N_RESCALED_PAIRS:
                        self.scale = OVERSHOOT_SHRINKAGE * self.scale
                    return best
                low = step
            step = (low + high) / 2 if high < float("inf") else 2 * low
        return best if best is None else (best[0], *self._at(best[0]))

    @torch.no_grad()
    def _at(self, x: Tensor) -> tuple[float, Tensor]:
        pieces = x.split([p.numel() for p in self.parameters])
        for parameter, piece in zip(self.parameters, pieces, strict=True):
            parameter.copy_(piece.reshape(parameter.shape))
        value, gradients = self.gradient()
        return value, self._flat(gradients)

    @staticmethod
    def _flat(tensors: Sequence[Tensor]) -> Tensor:
        return torch.cat([t.detach().flatten() for t in tensors])


def _pair(s: Tensor, y: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    return s, y, 1 / torch.dot(s, y)


def _interpolate_step(step: float, rise: float, descent: float) -> float:
    """Where the parabola through a start, with its slope, and a `rise` at `step` is least; a tenth to a half of it."""
    bent = rise - step * descent
    return step * min(0.5, max(0.1, -step * descent / (2 * bent))) if math.isfinite(bent) else step / 2
