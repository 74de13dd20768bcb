"""How well a burst determines what was estimated from it: standard deviations at each pixel, and one figure."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepir.optim.fourier_hessian import spline_response, variance_spectrum
from deepir.problem import Problem

Maps = dict[str, np.ndarray]


@torch.no_grad()
def nuc_penalty_db(problem: Problem, weak: float = 1.0) -> float:
    """What it costs the scene, in dB, that the pattern is not known; NaN where there is no model of it.

    Mean squared errors of the scene's waves, the pattern unknown over known, by the model of
    `deepir.optim.preconditioner`. Noise alone gives `10 log10 (n / (n - 1))` for n frames and any pattern, and
    waves that fit the motion more. `weak` times the scene's penalties is what held them while the pattern was found.
    """
    found = [variance_spectrum(problem, each, weak) for each in (problem.closed_form(), ())]
    if any(each is None for each in found):
        return math.nan
    response = spline_response(problem)
    response[0, 0] = 0  # no burst shows the level
    free, known = (float((response * each).sum()) for each in found if each is not None)
    return 10 * math.log10(free / known)


@torch.no_grad()
def uncertainty(problem: Problem, cost: float) -> Maps:
    """Standard deviations of `scene` (S, 1, H, W), `gain` and `offset` (h, w), in their units.

    Scene: the noise of the samples that see a pixel, carried back to it, times the pattern's cost. Gain and offset:
    posterior deviations given the scene, so rather too small. What is not estimated in closed form is left out;
    and so are both where each frame has a scene of its own: given the scenes, they would be known exactly.
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
    """Standard deviation (h, w) of the offset `o - (g - 1) L` of data that are measured from zero, not from L."""
    parts, (aa, ab, bb), _ = next(problem.solved(values, problem.closed_form()).information_blocks())
    u, v = (float(part.sigma) ** 2 if part else 0.0 for part in parts)
    covariance = -ab * u * v / (1 + u * aa + v * bb + u * v * (aa * bb - ab * ab))
    level = float(problem.reference)
    variance = (
        offset.square() + level**2 * gain.square() - 2 * level * covariance.reshape(offset.shape).to(offset)
    )
    return variance.clamp_min(0).sqrt()
