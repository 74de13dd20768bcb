"""Samples that say nothing: outliers, and places that no frame sees."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.arrays.windows import fill_pull_push
from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import down_weight_outliers
from deepir.optim.preconditioner import MIN_FRAMES_SEEN
from deepir.problem import Problem
from deepir.registry import register


@register("effect", "outliers")
@dataclass(frozen=True)
class Outliers(Effect):
    """Down-weights samples with large residuals in the initial estimate (Cauchy weights)."""

    def reject(self, estimate: InitialEstimate) -> None:
        # Gains of frames are found by least squares, not by outliers: weights come before them only in pictures.
        if estimate.step > 0 or estimate.problem.agc:
            down_weight_outliers(estimate.problem, estimate.residual)


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
