"""Held-out samples."""

from __future__ import annotations

import math

import torch

from deepir.arrays.statistics import masked_values
from deepir.joint_problem import AnyProblem


@torch.no_grad()
def held_out_error(problem: AnyProblem) -> float:
    """Root mean square error at the held-out samples, in the data's units; NaN without any."""
    found = []
    for each in problem.data_sets:
        held = each.held_out & (each.precision > 0)
        if held.any():
            found.append(masked_values(each.predict(each.values()) - each.data, held))
    return float(torch.cat(found).square().mean().sqrt()) if found else math.nan


def has_held_out(problem: AnyProblem) -> bool:
    """Whether any sample is held out."""
    return any(bool(each.held_out.any()) for each in problem.data_sets)


#: Fraction of the samples that is held out.
HELD_OUT_FRACTION = 0.02


def hold_out(problem: AnyProblem, seed: int, fraction: float = HELD_OUT_FRACTION) -> None:
    """Hold out a random fraction of the samples."""
    generator = torch.Generator().manual_seed(seed)
    for each in problem.data_sets:
        chosen = torch.rand(each.data.shape, generator=generator) < fraction
        each.held_out.copy_(chosen.to(each.held_out.device))
