"""Uncertainty of the estimates: standard deviations of maps, and the pattern cost."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepir.optim.fourier_hessian import spline_response, variance_spectrum
from deepir.problem import Problem

Maps = dict[str, np.ndarray]


@torch.no_grad()
def pattern_cost_db(problem: Problem, penalty_factor: float = 1.0) -> float:
    """Pattern cost, dB: ratio of the scene's mean squared error with unknown to that with known gain and offset.

    Both errors are those of the model of `deepir.optim.preconditioner`. For white noise and any pattern the cost is
    `10 log10 (n / (n - 1))` for n frames.

    Args:
        problem: Its current values are the point of expansion.
        penalty_factor: Factor on the scene's penalties while the pattern was estimated.

    Returns:
        The cost; NaN without a Fourier model.
    """
    found = [variance_spectrum(problem, each, penalty_factor) for each in (problem.closed_form(), ())]
    if any(each is None for each in found):
        return math.nan
    response = spline_response(problem)
    response[0, 0] = 0  # no burst shows the level
    free, known = (float((response * each).sum()) for each in found if each is not None)
    return 10 * math.log10(free / known)


@torch.no_grad()
def uncertainty(problem: Problem, cost: float) -> Maps:
    """Standard deviations of the estimates, in their units.

    Scene: noise of the samples, back-projected, times the pattern cost. Gain and offset: posterior given the
    scene, hence slightly too small; left out without a closed form, or if each frame has a scene of its own.

    Args:
        problem: Its current values are the estimates.
        cost: Pattern cost, dB.

    Returns:
        `scene` (S, 1, H, W), `gain` and `offset` (h, w), float32.
    """
    values = problem.values()
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    seen = problem.operator.adjoint(problem.precision, tuple(values["scene"].shape), **slots)
    found = {"scene": (seen.clamp(min=float(seen.max()) * 1e-6).rsqrt() * 10 ** (cost / 20))}
    closed = problem.closed_form()
    if closed and len(seen) == 1:
        for name, variances in problem.eliminate(values, closed, precision=problem.precision).items():
            parts = problem.fields[name].parts()
            total = sum(part.map_variance(each) for part, each in zip(parts, variances, strict=True))
            if isinstance(total, Tensor):
                found[name] = total.expand(problem.fields[name].shape)[0, 0].sqrt()
        if problem.reference and len(closed) == 2:
            gain, offset = closed
            found[offset] = _from_zero(problem, values, found[gain], found[offset])
    return {name: each.cpu().numpy().astype(np.float32) for name, each in found.items()}


def _from_zero(problem: Problem, values: dict[str, Tensor], gain: Tensor, offset: Tensor) -> Tensor:
    """Standard deviation (h, w) of the offset `o - (g - 1) L` relative to zero instead of the reference level L."""
    parts, (aa, ab, bb), _ = next(problem.solved(values, problem.closed_form()).information_blocks())
    u, v = (float(part.sigma) ** 2 if part else 0.0 for part in parts)
    covariance = -ab * u * v / (1 + u * aa + v * bb + u * v * (aa * bb - ab * ab))
    level = float(problem.reference)
    variance = (
        offset.square() + level**2 * gain.square() - 2 * level * covariance.reshape(offset.shape).to(offset)
    )
    return variance.clamp_min(0).sqrt()
