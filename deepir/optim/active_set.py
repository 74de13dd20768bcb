"""Saturated samples as bounds: active set of a bounded least-squares problem."""

from __future__ import annotations

import torch

from deepir.arrays.noise_level import median_sigma
from deepir.joint_problem import AnyProblem
from deepir.likelihoods import CAUCHY_SCALE

#: Violation of a bound by the prediction from which the sample counts, standard deviations of the noise.
BOUND_VIOLATION = 2.0


@torch.no_grad()
def deactivate_bounds(problem: AnyProblem) -> None:
    """Give saturated samples zero weight, as estimates of hyperparameters need."""
    for each in problem.data_sets:
        if each.saturation is not None:
            each.precision.masked_fill_(each.saturation != 0, 0)


@torch.no_grad()
def activate_bounds(problem: AnyProblem) -> None:
    """Give weight to saturated samples whose prediction violates the bound by `BOUND_VIOLATION`, and to no others."""
    deactivate_bounds(problem)
    for each in problem.data_sets:
        if each.saturation is None:
            continue
        noise = median_sigma(each.precision)
        short = each.saturation * (each.data - each.predict(each.values())) / noise
        doubt = 1 + (short / CAUCHY_SCALE).square()
        each.precision.add_((short > BOUND_VIOLATION) / (doubt * noise**2))
