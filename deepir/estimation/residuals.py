"""Residuals of the frames, and their temporal mean."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, robust_std, subsample
from deepir.likelihoods import CAUCHY_SCALE
from deepir.problem import Problem
from deepir.registered_average import RegisteredAverage


@torch.no_grad()
def fixed_pattern_residual(problem: Problem, average: RegisteredAverage | None = None) -> Tensor:
    """What the frames are above their prediction, (N, 1, h, w), once the scene has followed what is no pattern of it.

    An average is smooth: without that step a small bright thing stays in all frames, and passes for what moves.
    `average` spares its computation where it is known.
    """
    values = problem.values()
    rest = problem.data - problem.predict(values)
    weight = problem.precision / problem.precision.amax()
    return problem.beside(values, rest - temporal_mean(rest, weight), average)


def temporal_mean(rest: Tensor, weight: Tensor) -> Tensor:
    """The mean of that over the frames, (1, 1, h, w), by the weight of their samples."""
    total, share = (torch.zeros_like(rest[:1]) for _ in range(2))
    for rest_k, weight_k in zip(rest, weight, strict=True):  # one at a time stays in the cache
        total.addcmul_(rest_k, weight_k)
        share += weight_k
    return total.div_(share.clamp_(min=1e-6))


@torch.no_grad()
def down_weight_outliers(problem: Problem, rest: Tensor) -> None:
    """Let samples count less that neither the scene as it is nor a pattern explains.

    They are badly registered, or what they show moves by itself.
    """
    if problem.noise is not None:
        return
    most = problem.precision.amax()
    rest = rest - temporal_mean(rest, problem.precision / most)
    some, known = subsample(rest, problem.precision)
    if (usual := robust_std(masked_values(some, known > 0))) > 0:  # one frame leaves nothing
        for rest_k, precision_k in zip(rest, problem.precision, strict=True):
            doubt = rest_k.div_(CAUCHY_SCALE * usual).square_().add_(1)
            torch.div(precision_k > 0, doubt, out=precision_k).mul_(most)
