"""What no frame sees of the scene: it is to go on smoothly from where some frame does."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.arrays.fill import fill_pull_push
from deepir.effects.effect import Effect
from deepir.optim.preconditioner import MIN_FRAMES_SEEN
from deepir.problem import Problem
from deepir.registry import register


@torch.no_grad()
def fill_unobserved(problem: Problem) -> None:
    """Let the scene go on smoothly where no frame sees it.

    No data hold it there. Left alone it keeps the pattern that the scene once had at its edge, and a solve spends most
    of its iterations on what the penalties make of that.
    """
    known = observed(problem, problem.precision > 0)
    if not known.all():
        problem.fields["scene"].init_from(fill_pull_push(problem.values()["scene"], known))


@torch.no_grad()
def observed(problem: Problem, usable: Tensor) -> Tensor:
    """Where some frame sees the scene, bool, in the scene's shape, by samples that are `usable`, (N, C, h, w), bool."""
    values = problem.values()
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    weight = problem.operator.adjoint(usable.to(problem.data), tuple(values["scene"].shape), **slots)
    return weight > MIN_FRAMES_SEEN * weight.max() / len(problem.data)


@register("effect", "unobserved")
@dataclass(frozen=True)
class Unobserved(Effect):
    """Parts of the scene that no frame sees."""

    compares_frames = True

    def initialise(self, problem: Problem) -> None:
        fill_unobserved(problem)

    def update(self, problem: Problem, *, settled: bool) -> bool:
        fill_unobserved(problem)
        return False
