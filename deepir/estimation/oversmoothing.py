"""Whether the scene's prior is too strong: it has taken more than noise.

Where a prior makes the scene flat it takes the noise that was left there, a square standard deviation for each pixel,
and the frames are explained so much worse than by the scene before. What they are explained worse than that was scene.
"""

from __future__ import annotations

import math

import torch

from deepir.problem import Problem

MORE = 0.1  # variances of the noise for each pixel, by which more was taken than noise
PLAIN = 0.4  # share of a scene that is flat, from which that tells: beside much texture it comes and goes
LOOSER = 2**-0.5  # share of its weight that is left to a penalty that took more


@torch.no_grad()
def store_reference_misfit(problem: Problem) -> None:
    """Keep how far the frames are from what the unknowns say now, under next to no prior."""
    problem.rough.copy_(_misfit(problem))


def is_oversmoothed(problem: Problem) -> bool:
    """Whether more than noise was taken from the scene; not, where that cannot be told."""
    flat = _flat(problem)
    if not flat > PLAIN:
        return False
    taken = float(_misfit(problem) - problem.rough) / int(problem.alive().sum())
    return taken - flat > MORE


def reduce_weight(problem: Problem) -> None:
    """Let the scene's penalties be weaker."""
    for penalty in problem.penalties["scene"].values():
        penalty.weight.mul_(LOOSER)


@torch.no_grad()
def _misfit(problem: Problem) -> torch.Tensor:
    return 2 * problem.misfit(problem.values(), (), problem.precision)


@torch.no_grad()
def _flat(problem: Problem) -> float:
    """The share of the scene that its penalty makes flat; NaN if there is not one that its noise gives its weight."""
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if len(penalties) != 1 or penalties[0].user_weight is not None:
        return math.nan
    scene = problem.values()["scene"]
    return penalties[0].fraction_shrunk_to_zero(problem.shown("scene", scene, penalties[0]))
