"""Residuals of frames, and the levels of their lines."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, robust_std, subsample
from deepir.fields.line_noise import LineNoise
from deepir.likelihoods import CAUCHY_SCALE
from deepir.metrics import RegisteredAverage
from deepir.problem import Problem


@torch.no_grad()
def fixed_pattern_residual(problem: Problem, average: RegisteredAverage | None = None) -> Tensor:
    """Residual after a scene update that leaves out the fixed-pattern part.

    The present scene may be too smooth: without the update a small bright object leaves a residual in all frames. Data
    minus prediction, (N, 1, h, w). The registered average is computed if it is not known.
    """
    values = problem.values()
    rest = problem.data - problem.predict(values)
    weight = problem.precision / problem.precision.amax()
    return problem.residual_after_scene_step(values, rest - temporal_mean(rest, weight), average)


def temporal_mean(rest: Tensor, weight: Tensor) -> Tensor:
    """Weighted temporal mean of residuals (N, 1, h, w), (1, 1, h, w): the fixed pattern that is not modelled yet."""
    total, weight_sum = (torch.zeros_like(rest[:1]) for _ in range(2))
    for rest_k, weight_k in zip(rest, weight, strict=True):  # one at a time stays in the cache
        total.addcmul_(rest_k, weight_k)
        weight_sum += weight_k
    return total.div_(weight_sum.clamp_(min=1e-6))


@torch.no_grad()
def down_weight_outliers(problem: Problem, rest: Tensor) -> None:
    """Down-weight samples with a large residual (N, 1, h, w) by Cauchy weights; nothing if the noise is known."""
    if problem.noise is not None:
        return
    most = problem.precision.amax()
    rest = rest - temporal_mean(rest, problem.precision / most)
    some, known = subsample(rest, problem.precision)
    if (typical := robust_std(masked_values(some, known > 0))) > 0:  # one frame leaves nothing
        for rest_k, precision_k in zip(rest, problem.precision, strict=True):
            inverse_weight = rest_k.div_(CAUCHY_SCALE * typical).square_().add_(1)
            torch.div(precision_k > 0, inverse_weight, out=precision_k).mul_(most)


def line_noise_fields(problem: Problem) -> list[LineNoise]:
    """The fields of temporal line noise of a problem."""
    fields = [problem.fields[name] for name in problem.free()]
    return [module for field in fields for module in field.modules() if isinstance(module, LineNoise)]


def has_line_noise(problem: Problem) -> bool:
    """Whether any temporal line noise has a positive standard deviation."""
    return any(field.sigma > 0 for field in line_noise_fields(problem))
