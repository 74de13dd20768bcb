"""Temporal row and column noise in the estimates of other parts."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.fields.line_noise import LineNoise
from deepir.fields.shading import Shading
from deepir.problem import Problem


def line_noise_fields(problem: Problem) -> list[LineNoise]:
    """The fields of temporal line noise of a problem."""
    fields = [problem.fields[name] for name in problem.free()]
    return [module for field in fields for module in field.modules() if isinstance(module, LineNoise)]


def has_line_noise(problem: Problem) -> bool:
    """Whether any temporal line noise has a positive standard deviation."""
    return any(field.sigma > 0 for field in line_noise_fields(problem))


def line_noise_in_polynomials(problem: Problem, frame: Shading) -> Tensor:
    """Variance of line noise in the level and the polynomials of a frame, (terms + 1,)."""
    level = torch.zeros_like(frame.order_y[:1])
    of_y, of_x = torch.cat((level, frame.order_y)), torch.cat((level, frame.order_x))
    found = torch.zeros(len(of_y), dtype=torch.float64, device=of_y.device)
    for field in line_noise_fields(problem):
        constant = (of_x if field.line_axis == -2 else of_y) == 0
        found += constant * field.frame_mean_variance
    return found


def subtract_line_means(problem: Problem, values: Tensor) -> Tensor:
    """Values (..., h, w) less their means along lines with temporal noise."""
    for field in line_noise_fields(problem):
        if field.sigma > 0:
            values = values - values.mean(-3 - field.line_axis, keepdim=True)
    return values
