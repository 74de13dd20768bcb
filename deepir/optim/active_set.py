"""Saturated samples as bounds: active set of a bounded least-squares problem."""

from __future__ import annotations

import torch

from deepir.arrays.noise_level import median_sigma
from deepir.likelihoods import CAUCHY_SCALE
from deepir.problem import Problem

#: Violation of a bound by the prediction from which the sample counts, standard deviations of the noise.
BOUND_VIOLATION = 2.0


@torch.no_grad()
def deactivate_bounds(problem: Problem) -> None:
    """Give saturated samples zero weight, as estimates of hyperparameters need."""
    if problem.saturation is not None:
        problem.precision.masked_fill_(problem.saturation != 0, 0)


@torch.no_grad()
def activate_bounds(problem: Problem) -> None:
    """Give weight to saturated samples whose prediction violates the bound by `BOUND_VIOLATION`, and to no others."""
    if problem.saturation is None:
        return
    deactivate_bounds(problem)
    noise = median_sigma(problem.precision)
    short = problem.saturation * (problem.data - problem.predict(problem.values())) / noise
    doubt = 1 + (short / CAUCHY_SCALE).square()
    problem.precision.add_((short > BOUND_VIOLATION) / (doubt * noise**2))
