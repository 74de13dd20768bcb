"""How noisy the samples are, by what a fit leaves of them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from deepir.arrays.statistics import (
    MAD_TO_SIGMA,
    ROUNDING_SIGMA,
    masked_values,
    median,
    quantisation_step,
    sample_noise,
    subsample,
)
from deepir.effects.bad_pixels import misfitting_pixels, neighbourhood_doubt, with_scene_error
from deepir.effects.effect import Effect
from deepir.likelihoods import CAUCHY_SCALE
from deepir.problem import NoiseModel, Problem
from deepir.registry import register

SIGNAL_BINS = 10  # in which the noise is measured
HUBER_K = 2.0  # standard deviations at which residuals are clipped (Huber 1964, proposal 2)
HUBER_CONSISTENCY = 0.920537  # mean square of a Gaussian clipped there
HUBER_STEPS = 6


@torch.no_grad()
def update_noise(problem: Problem, *, settled: bool = False) -> None:
    """Set each sample's precision to 1 / (read² + signal / photons): the noise that is given, or the measured one.

    The signal is what the light does: the prediction without the offset. Samples that misfit count less, beside what
    the scene would follow; with `settled`, pixels that misfit throughout are given up.
    """
    values = problem.values()
    prediction = problem.predict(values)
    offset = problem.sensor_unknowns().get("offset")
    signal = (prediction - values[offset] if offset else prediction.clone()) + problem.reference
    signal.clamp_(min=0)
    noise = problem.noise or estimate_noise(problem, prediction, signal)
    if noise is None:
        return
    usable = problem.precision > 0
    misfit = problem.residual_after_scene_step(values, problem.data - prediction)
    # A frame at a time: what is needed on the way stays in the cache.
    for k, signal_k in enumerate(signal):
        signal_k.mul_(noise.per_unit).add_(noise.read).clamp_(min=noise.floor)  # from here on, the variance
        misfit[k].square_().mul_(usable[k]).div_(signal_k)
    if settled:
        bounds = usable if problem.saturation is None else usable | (problem.saturation != 0)  # which misfit nothing
        light = problem.flux(values) if offset else prediction
        own = with_scene_error(misfit, light, usable & ~problem.moving, signal)
        usable &= ~misfitting_pixels(own, bounds)
    for k, variance_k in enumerate(signal):
        doubt = neighbourhood_doubt(misfit[k : k + 1], usable[k : k + 1])[0]
        doubt.add_(misfit[k], alpha=CAUCHY_SCALE**-2).add_(1).mul_(variance_k)
        torch.div(usable[k], doubt, out=problem.precision[k])


def estimate_noise(problem: Problem, prediction: Tensor, signal: Tensor) -> NoiseModel | None:
    """Noise model fitted to the residuals in bins of the signal; None if there are too few.

    Residuals of fitted samples are too small, by the freedom that the fit has, and those of held-out samples too
    large, by the same: for a linear fit of leverage h, `σ² (1 - h)` and `σ² / (1 - h)`. So their geometric mean is
    the noise, in bins of the signal.
    """
    frames = subsample(prediction, problem.data, problem.precision, problem.held_out, signal)
    some, data, precision, held, light = (each.flatten() for each in frames)
    counts, residual = precision > 0, (some - data).abs_()
    # By bin, the fitted samples and those held out: each group's lie side by side, which spares twenty masks.
    group = (2 * _bins(light, counts) + held).where(counts, 2 * SIGNAL_BINS).to(torch.uint8).cpu().numpy()
    order = torch.from_numpy(np.argsort(group, kind="stable")).to(residual.device)
    sizes = np.bincount(group, minlength=2 * SIGNAL_BINS + 1).tolist()
    residuals, totals = residual[order].split(sizes), np.bincount(group, light.cpu().numpy(), 2 * SIGNAL_BINS)
    # Data that are rounded more coarsely than they are noisy may leave no residual at all.
    rounding = (torch.finfo(problem.data.dtype).eps * float((some * counts).max())) ** 2
    least = (ROUNDING_SIGMA * quantisation_step(problem.data, problem.precision > 0)) ** 2
    rows, seen = [], []
    for i in range(0, 2 * SIGNAL_BINS, 2):
        fitted, new = residuals[i : i + 2]
        if len(new) >= 20:
            rows.append((1.0, sum(totals[i : i + 2]) / sum(sizes[i : i + 2])))
            seen.append(max(huber_scale(fitted) * huber_scale(new) + rounding, least))
    if not rows:
        return None
    design, variance = np.array(rows), np.array(seen)
    unit = design.max(0).clip(min=1e-30)
    relative = design / unit / variance[:, None]  # errors are in proportion to the variance
    share, _ = nnls(relative, np.ones(len(rows)))
    read, photon = share / unit
    return NoiseModel(float(read), float(photon), 0.1 * float(variance.min()))


def huber_scale(residuals: Tensor) -> float:
    """Standard deviation by what residuals (K) are in size, wild ones bounded (Huber 1964, proposal 2).

    Unlike the median it reads right what is a mixture: within a bin variances and leverages differ.
    """
    found = MAD_TO_SIGMA * median(residuals)
    for _ in range(HUBER_STEPS):
        found = math.sqrt(float(residuals.clamp(max=HUBER_K * found).square_().mean()) / HUBER_CONSISTENCY)
    return found


def _bins(values: Tensor, counts: Tensor) -> Tensor:
    """Number of the quantile bin of each value, of those that count."""
    each = max(1, len(values) // 20_000)
    some = masked_values(values[::each], counts[::each]).cpu().numpy()
    edges = np.quantile(some, np.linspace(0, 1, SIGNAL_BINS + 1)[1:-1])  # torch takes ten times as long
    return torch.bucketize(values.contiguous(), torch.from_numpy(edges).to(values))


def start_precision(problem: Problem) -> None:
    """Set the precision of usable samples to 1 / variance of the noise that the frames show, if none is given."""
    if problem.noise is not None:
        return
    usable = problem.precision > 0
    sigma = sample_noise(problem.data[:, 0], usable[:, 0])
    data, counts = subsample(problem.data, usable)
    data_sigma = float(masked_values(data, counts).std())
    rounded = ROUNDING_SIGMA * quantisation_step(problem.data, usable)  # in a plain scene differences may be all zero
    # Noiseless data: a solve still wants finite weights.
    sigma = max(sigma, rounded, 1e-4 * data_sigma)
    problem.precision.copy_(usable / sigma**2)


@register("effect", "noise")
@dataclass(frozen=True)
class Noise(Effect):
    """The noise of the samples: read noise and photon noise, from the residuals of fitted and of held-out samples."""

    def prepare(self, problem: Problem) -> None:
        start_precision(problem)

    def update(self, problem: Problem, *, settled: bool) -> bool:
        update_noise(problem)
        return False

    def finish(self, problem: Problem) -> None:
        update_noise(problem, settled=True)
