"""Held-out samples."""

from __future__ import annotations

import math

import torch

from deepir.arrays.statistics import masked_values
from deepir.problem import Problem


@torch.no_grad()
def held_out_error(problem: Problem) -> float:
    """Root mean square error at the held-out samples, in the data's units; NaN without any."""
    held = problem.held_out & (problem.precision > 0)
    if not held.any():
        return math.nan
    residual = masked_values(problem.predict(problem.values()) - problem.data, held)
    return float(residual.square().mean().sqrt())


#: Fraction of the samples that is held out.
HELD_OUT_FRACTION = 0.02


def hold_out(problem: Problem, seed: int, fraction: float = HELD_OUT_FRACTION) -> None:
    """Hold out a random fraction of the samples."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.rand(problem.data.shape, generator=generator) < fraction
    problem.held_out.copy_(chosen.to(problem.held_out.device))
