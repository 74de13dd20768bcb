"""The error at samples that no fit sees."""

from __future__ import annotations

import math

import torch

from deepir.arrays.subsample import masked_values
from deepir.problem import Problem


@torch.no_grad()
def held_out_error(problem: Problem) -> float:
    """Root mean square error at the held-out samples, in the data's units; NaN without any."""
    held = problem.held_out & (problem.precision > 0)
    if not held.any():
        return math.nan
    residual = masked_values(problem.predict(problem.values()) - problem.data, held)
    return float(residual.square().mean().sqrt())
