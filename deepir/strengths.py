"""Strengths from the data: how noisy the samples are, and how strong each part of gain and offset.

Everything is estimated between the stages of a solve, from what the stage before it found, and stays fixed during a
stage, so that the objective is one function.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from deepir.noise import MAD
from deepir.priors.parts import Part
from deepir.problem import Problem

HELD_OUT = 0.02  # share of the samples that no fit sees
BINS = 10  # of the signal, in which the noise is measured
ROUNDS = 3  # of expectation-maximisation at each update
#: Weak prior on the variance of a part: so much of its number of values, at so large a sigma.
PSEUDO_SHARE, PSEUDO_GAIN, PSEUDO_OFFSET = 0.2, 0.02, 0.03


def hold_out(problem: Problem, seed: int) -> None:
    """Choose the samples that are held out."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.rand(problem.data.shape, generator=generator) < HELD_OUT
    problem.held_out.copy_(chosen.to(problem.held_out.device))


@torch.no_grad()
def update_noise(problem: Problem) -> None:
    """Set each sample's precision to 1 / (read² + signal / photons), as the residuals have it.

    Residuals of fitted samples are too small, by the freedom that the fit has, and those of held-out samples too
    large, by the same: for a linear fit of leverage h, `σ² (1 - h)` and `σ² / (1 - h)`. So their geometric mean is
    the noise. It is taken in bins of the signal, from medians, which leave outliers out.
    """
    if problem.known_noise:
        return
    prediction = problem.predict(problem.values())
    usable = problem.precision > 0
    residual, signal = (prediction - problem.data)[usable].abs(), prediction[usable].clamp(min=0)
    held, bins = problem.held_out[usable], _bins(signal)
    rows, seen = [], []
    for i in range(BINS):
        fitted, new = residual[(bins == i) & ~held], residual[(bins == i) & held]
        if len(new) >= 20:
            rows.append((1.0, float(signal[bins == i].mean())))
            seen.append(float(MAD**2 * fitted.median() * new.median()))
    design, variance = np.array(rows), np.array(seen)
    unit = design.max(0).clip(min=1e-30)
    share, _ = nnls(design / unit / variance[:, None], np.ones(len(rows)))  # errors are in proportion to the variance
    read, photon = share / unit
    found = read + photon * prediction.clamp(min=0)
    problem.precision.copy_(usable / found.clamp(min=0.1 * variance.min()))


def _bins(values: Tensor) -> Tensor:
    """Number of the quantile bin of each value."""
    some = values[:: max(1, len(values) // 100_000)]
    edges = torch.quantile(some, torch.linspace(0, 1, BINS + 1).to(some))
    return torch.bucketize(values, edges[1:-1])


def weigh_scene(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights of the scene's penalties: `factor` times what is given, or what suits the noise."""
    precision = problem.precision.sum(0)  # the frames' information adds up
    noise = float(precision[precision > 0].median().rsqrt())
    for penalty in problem.penalties["scene"].values() if "scene" in problem.penalties else ():
        penalty.weight.fill_(factor * (penalty.natural(noise) if penalty.given is None else penalty.given))


@torch.no_grad()
def start_parts(problem: Problem) -> None:
    """First strengths of gain and offset: from the frames less their registered average, split evenly."""
    prediction = problem.predict(problem.values())
    usable = problem.precision > 0
    count = usable.sum(0, keepdim=True).clamp(min=1)
    pattern = ((problem.data - prediction) * usable).sum(0, keepdim=True) / count
    level = float(problem.data[usable].mean().abs())
    for slot, unit in (("gain", level), ("offset", 1.0)):
        for part in _parts(problem, slot):
            if part.given:
                continue
            mine = pattern.mean(part.along, keepdim=True) if part.along else pattern - pattern.mean(-1, keepdim=True) - pattern.mean(-2, keepdim=True)
            part.sigma.fill_(float(MAD * (mine - mine.median()).abs().median()) / 2**0.5 / unit)


@torch.no_grad()
def update_parts(problem: Problem) -> None:
    """Expectation-maximisation of the parts' variances, the scene held: `mean(value² + posterior variance)`."""
    values = problem.values()
    flux = problem.flux(values)
    usable = problem.precision > 0
    low, high = torch.quantile(flux[usable][::97], torch.tensor([0.01, 0.99]).to(flux))
    anchors = {"gain": PSEUDO_GAIN, "offset": PSEUDO_OFFSET * float(high - low)}
    for _ in range(ROUNDS):
        found = problem.eliminate(values, problem.closed_form(), flux=flux)
        for slot, anchor in anchors.items():
            for part, variance in zip(_parts(problem, slot), found.get(slot, []), strict=True):
                if not part.given:
                    part.sigma.copy_(_maximised(part, variance, anchor))


def _maximised(part: Part, variance: Tensor, anchor: float) -> Tensor:
    mean = (part.values.square() + variance).mean()
    return ((mean + PSEUDO_SHARE * anchor**2) / (1 + PSEUDO_SHARE)).sqrt()


def _parts(problem: Problem, unknown: str) -> list[Part]:
    return list(problem.fields[unknown].parts()) if unknown in problem.closed_form() else []
