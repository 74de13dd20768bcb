"""Detect an oversmoothed scene by the discrepancy principle.

A prior that flattens a region removes its noise: the squared residual grows by one noise variance per pixel. Growth
beyond that is removed scene.

Source: Morozov 1966, "On the solution of functional equations by the method of regularization".
"""

from __future__ import annotations

import math

import torch

from deepir.joint_problem import AnyProblem
from deepir.problem import Problem

#: Excess of the squared residual over pure noise from which a scene is oversmoothed, noise variances per pixel.
MAX_EXCESS_MISFIT = 0.1
#: Fraction of the scene that must be flat for the test: beside much texture the residual varies by more.
MIN_FLAT_FRACTION = 0.4
#: Factor on the weight of a penalty that oversmooths.
WEIGHT_REDUCTION = 2**-0.5


@torch.no_grad()
def store_reference_misfit(problem: Problem) -> None:
    """Store the squared residual of the present estimate, obtained with a weak prior, as the reference."""
    problem.reference_misfit.copy_(_squared_residual(problem))


def is_oversmoothed(problem: AnyProblem) -> bool:
    """Whether the prior has removed more than noise from a scene; False if the test does not apply."""
    return any(map(_is_oversmoothed, problem.data_sets))


def _is_oversmoothed(problem: Problem) -> bool:
    flat = _flat_fraction(problem)
    if not flat > MIN_FLAT_FRACTION:
        return False
    taken = float(_squared_residual(problem) - problem.reference_misfit) / int(problem.alive().sum())
    return taken - flat > MAX_EXCESS_MISFIT


def reduce_weight(problem: AnyProblem) -> None:
    """Multiply the weights of the penalties by `WEIGHT_REDUCTION` where a scene is oversmoothed."""
    for each in filter(_is_oversmoothed, problem.data_sets):
        for penalty in each.penalties["scene"].values():
            penalty.weight.mul_(WEIGHT_REDUCTION)


@torch.no_grad()
def _squared_residual(problem: Problem) -> torch.Tensor:
    return 2 * problem.misfit(problem.values(), (), problem.precision)


@torch.no_grad()
def _flat_fraction(problem: Problem) -> float:
    """Fraction of the scene that its penalty flattens; NaN unless there is one penalty with an automatic weight."""
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if len(penalties) != 1 or penalties[0].user_weight is not None:
        return math.nan
    scene = problem.values()["scene"]
    return penalties[0].fraction_shrunk_to_zero(problem.shown("scene", scene, penalties[0]))
