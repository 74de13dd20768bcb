"""Strengths from the data: how noisy the samples are, and how strong each part of gain and offset.

Everything is estimated between the stages of a solve, from what the stage before it found, and stays fixed during a
stage, so that the objective is one function.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import nnls
from torch import Tensor

from deepir.defects import crowded, defective, deviating
from deepir.levels import reach, tilt
from deepir.noise import MAD
from deepir.priors.parts import Part
from deepir.priors.shading import Shading
from deepir.problem import Problem

HELD_OUT = 0.02  # share of the samples that no fit sees
OUTLIER = 5.0  # residual, in standard deviations, at which a sample counts half (Cauchy's weights)
BINS = 10  # of the signal, in which the noise is measured
TAIL = 12.0  # medians of a squared value beyond which it is an outlier
ROUNDS = 3  # of expectation-maximisation at each update
#: A part is at most so many times as strong as the frames' average shows it: where the scene is not quite the same in
#: all frames (parallax), gain and offset would otherwise grow to explain it, and cancel each other.
MOST = 1.5
#: A term of the shading, as a share of what the frames' tilt makes of a quadratic one.
SHADING = 0.4
#: Weak prior on the variance of a part: so much of its number of values, at so large a sigma.
PSEUDO_SHARE, PSEUDO_GAIN, PSEUDO_OFFSET = 0.2, 0.02, 0.03


def hold_out(problem: Problem, seed: int) -> None:
    """Choose the samples that are held out."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.rand(problem.data.shape, generator=generator) < HELD_OUT
    problem.held_out.copy_(chosen.to(problem.held_out.device))


@torch.no_grad()
def update_noise(problem: Problem, *, settled: bool = False) -> None:
    """Set each sample's precision to 1 / (read² + signal / photons), as the residuals have it.

    Residuals of fitted samples are too small, by the freedom that the fit has, and those of held-out samples too
    large, by the same: for a linear fit of leverage h, `σ² (1 - h)` and `σ² / (1 - h)`. So their geometric mean is
    the noise. It is taken in bins of the signal, from medians, which leave outliers out. Samples that misfit count
    less; with `settled`, pixels that misfit throughout are given up.
    """
    if problem.known_noise:
        return
    prediction = problem.predict(problem.values())
    usable = problem.precision > 0
    residual, signal = (prediction - problem.data)[usable].abs(), prediction[usable].clamp(min=0)
    held, bins = problem.held_out[usable], _bins(signal)
    # Data that are rounded more coarsely than they are noisy may leave no residual at all.
    rounding = (torch.finfo(problem.data.dtype).eps * float(signal.max())) ** 2
    rows, seen = [], []
    for i in range(BINS):
        fitted, new = residual[(bins == i) & ~held], residual[(bins == i) & held]
        if len(new) >= 20:
            rows.append((1.0, float(signal[bins == i].mean())))
            seen.append(float(MAD**2 * fitted.median() * new.median()) + rounding)
    if not rows:  # too few samples are held out to see any noise
        return
    design, variance = np.array(rows), np.array(seen)
    unit = design.max(0).clip(min=1e-30)
    relative = design / unit / variance[:, None]  # errors are in proportion to the variance
    share, _ = nnls(relative, np.ones(len(rows)))
    read, photon = share / unit
    found = read + photon * prediction.clamp(min=0)
    found = found.clamp(min=0.1 * variance.min())
    misfit = usable * (prediction - problem.data).square() / found
    if settled:
        usable = usable & ~defective(misfit, usable)
    problem.precision.copy_(usable / (found * (1 + misfit / OUTLIER**2 + crowded(misfit, usable))))


def _bins(values: Tensor) -> Tensor:
    """Number of the quantile bin of each value."""
    some = values[:: max(1, len(values) // 100_000)]
    edges = torch.quantile(some, torch.linspace(0, 1, BINS + 1).to(some))
    return torch.bucketize(values, edges[1:-1])


def weigh_scene(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights of the scene's penalties: `factor` times what is given, or what suits the noise.

    What else they need they learn from the scene as it is.
    """
    precision = problem.precision.sum(0)  # the frames' information adds up
    average = float(precision[precision > 0].median().rsqrt())
    with torch.no_grad():
        scene = problem.fields["scene"]()
    for penalty in problem.penalties["scene"].values() if "scene" in problem.penalties else ():
        noise = average * (1.0 if penalty.of_image else problem.operator.noise_gain)
        penalty.weight.fill_(factor * (penalty.natural(noise) if penalty.given is None else penalty.given))
        with torch.no_grad():
            penalty.adapt(problem.shown("scene", scene, penalty), noise)


@torch.no_grad()
def start_parts(problem: Problem) -> None:
    """First strengths of gain and offset, split evenly, from the pattern: the frames less their registered average.

    What is left of the frames then is badly registered, or moves by itself: such samples count less from the start.
    """
    rest = problem.data - problem.predict(problem.values())
    usable = problem.precision > 0
    pattern = (rest * usable).sum(0, keepdim=True) / usable.sum(0, keepdim=True).clamp(min=1)
    level = float(problem.data[usable].mean().abs())
    for slot, unit in (("gain", level), ("offset", 1.0)):
        for part in _all_parts(problem, slot):
            if isinstance(part, Shading) and not part.given:
                part.sigma.fill_(SHADING * tilt(problem) / max(reach(problem), 0.01) / unit)
                part.most.copy_(MOST * part.sigma)
            elif not part.given:
                part.sigma.fill_(_spread(_share(pattern, part)) / 2**0.5 / unit)
                part.most.copy_(MOST * part.sigma)
    problem.precision.mul_(~deviating(pattern, usable.any(0, keepdim=True)))
    rest, usable = rest - pattern, problem.precision > 0
    if not problem.known_noise and (spread := _spread(rest[usable])) > 0:  # one frame leaves nothing
        problem.precision.div_(1 + (rest / (OUTLIER * spread)).square())


def _share(pattern: Tensor, part: Part) -> Tensor:
    """The part's own share of a pattern: differences of neighbours, of the same variance.

    A part's values are independent, what the scene leaves in the pattern is mostly smooth.
    """
    own = pattern.mean(part.along, keepdim=True) if part.along else pattern
    for axis in {-2, -1} - set(part.along):
        own = own.diff(dim=axis) / 2**0.5
    return own


def _spread(values: Tensor) -> float:
    """Standard deviation of the bulk of the values."""
    return float(MAD * (values - values.median()).abs().median())


@torch.no_grad()
def keep_gauge(problem: Problem) -> None:
    """Carry what gain and offset have in common over to the scene: their parts are to be about one and zero.

    The data do not change with it, so nothing but the priors holds it, and it drifts.
    """
    values, closed = problem.values(), problem.closed_form()
    name = problem.operator.named()[-1][0]
    gain, offset = (problem.slots.get(f"{name}.{slot}", "") for slot in ("gain", "offset"))
    scene = values["scene"]
    if gain in closed:
        scene = scene * values[gain].mean()
    if offset in closed:
        scene = scene + values[offset].mean()
    problem.fields["scene"].init_from(scene)


@torch.no_grad()
def update_parts(problem: Problem) -> None:
    """Expectation-maximisation of the parts' variances, `mean(value² + posterior variance)`, the scene held."""
    if not problem.closed_form():
        return
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
    if isinstance(part, Shading):  # few terms, of which some are large
        return ((part.sigma * part.white).square() + variance).mean().sqrt().clamp(max=part.most)
    each = part.values.square() + variance
    spread = each.clamp(max=TAIL * each.median()).mean()
    return ((spread + PSEUDO_SHARE * anchor**2) / (1 + PSEUDO_SHARE)).sqrt().clamp(max=part.most)


def _all_parts(problem: Problem, slot: str) -> list[Part]:
    """Parts of what is bound to a slot of this name, whether they have a closed form or not."""
    unknowns = [name for each, name in problem.slots.items() if each.rpartition(".")[2] == slot]
    return [each for name in unknowns for each in problem.fields[name].modules() if isinstance(each, Part)]


def _parts(problem: Problem, unknown: str) -> list[Part]:
    return list(problem.fields[unknown].parts()) if unknown in problem.closed_form() else []
