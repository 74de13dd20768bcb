"""The fixed pattern of gain and offset: standard deviations of its parts, and the level that both are measured from.

Gain and offset have independent priors in the units of the data. That is right for a raw detector, whose gain acts on
all of its signal. Behind a shutter, a correction by the factory, or in the bolometer's own physics the pattern is small
at some level L of the data, and `offset = (1 - gain) L + rest`: the two are correlated. Measured from L, frames obey
the same equation with an offset that is independent of the gain again. So L is estimated by the marginal likelihood of
the pixels' parts, as their standard deviations are, and subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from deepir.arrays.samples import pattern_outliers
from deepir.arrays.statistics import masked_values, robust_std, subsample
from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import line_noise_fields, temporal_mean
from deepir.estimation.variance_components import MAX_SIGMA_RATIO, estimate_sigmas, high_pass, reference_level_nats
from deepir.fields.sensor_maps import GaussianMap
from deepir.fields.shading import Shading
from deepir.operators import Sensor
from deepir.problem import Problem, Values
from deepir.registry import register

LOW_ORDER_DEGREE = 8  # degree of the polynomial along 64 or more lines, which the scene may have
UPDATE_ROUNDS = 2  # rounds of the fixed-point iteration of the standard deviations
#: Nats of the pixels by which a first reference level other than zero has to be likelier, and a later one.
EVIDENCE_MARGIN, REFINEMENT_MARGIN = 100.0, 2.0
#: Standard deviations of the data by which a first level differs from zero: nearer, it makes little difference.
MIN_DEVIATIONS = 3.0
#: Levels at which the likelihood is compared first: shares of the data's mean, and quantiles of the data.
SHARES, QUANTILES = (0.25, 0.5, 0.75), (0.0, 0.1, 0.5, 0.9, 1.0)
LEVEL_PRECISION = 0.05  # share of the data's standard deviation to which the level is found
#: Relative error up to which the flux follows the scene's level, and share of the samples that may have more.
LEVEL_TOLERANCE, EXCEPTIONS_SHARE = 1e-3, 0.01


@torch.no_grad()
def start_parts(problem: Problem, rest: Tensor) -> None:
    """Set initial standard deviations of gain and offset parts, and drop outlying pixels.

    The fixed pattern is the temporal mean of `rest`; gain and offset take half of its variance each. That of the gain
    is divided by the rms of the data: a dark frame with bright spots shows next to nothing of the gain in most places.
    Its bound is by the mean of the data, unless a reference level is subtracted from them.

    Args:
        problem: The precision of pixels that are outliers of the pattern becomes zero.
        rest: Residual that contains the fixed pattern, (N, 1, h, w).
    """
    pattern = temporal_mean(rest, problem.precision.sign())  # as a float: torch is slow at the bool
    usable = problem.precision > 0
    data, counts = subsample(problem.data, usable)
    used = masked_values(data, counts)
    rms = float(used.square().mean().sqrt())
    level = rms if problem.reference else float(used.mean().abs())
    for slot, unit, most in (("gain", rms, level), ("offset", 1.0, 1.0)):
        parts = problem.fields[unknowns[slot]].modules() if (unknowns := problem.sensor_unknowns()) else ()
        for part in parts:  # whether they have a closed form or not
            if isinstance(part, GaussianMap) and not (part.sigma_is_fixed or isinstance(part, Shading)):
                found = robust_std(high_pass(pattern, part)) / 2**0.5
                part.sigma.fill_(found / unit)
                part.max_sigma.fill_(MAX_SIGMA_RATIO * found / most)
    known = usable.any(0, keepdim=True)
    # Of the median, too: one frame does not condemn a pixel.
    middle = rest.where(usable, torch.nan).nanmedian(0, keepdim=True).values.nan_to_num()
    bad = [pattern_outliers(*(m[0, 0].numpy(force=True) for m in (each, known))) for each in (pattern, middle)]
    problem.precision.mul_(~torch.from_numpy(bad[0] & bad[1]).to(known.device))


@torch.no_grad()
def update_parts(problem: Problem) -> None:
    """Set the standard deviations of the parts by marginal likelihood, the scene fixed.

    Parts along lines that were just found to jump wait for a round that knows of it.
    """
    unasked = {field.constant_axes for field in line_noise_fields(problem) if field.newly_detected}
    closed = problem.closed_form()
    if not closed:
        return
    values = problem.values()
    flux = problem.flux(values)
    for _ in range(UPDATE_ROUNDS):
        for parts, information, means in problem.solved(values, closed, flux=flux).information_blocks():
            sigma, most = (
                torch.stack([getattr(part, name).double() if part else means.new_zeros(()) for part in parts])
                for name in ("sigma", "max_sigma")
            )
            free = [i for i, p in enumerate(parts) if p and not p.sigma_is_fixed and p.constant_axes not in unasked]
            quick = high_order(means) if any(part and part.constant_axes for part in parts) else means
            for part, found in zip(parts, estimate_sigmas(information, quick, sigma, most, free), strict=True):
                if part and not part.sigma_is_fixed:
                    part.sigma.copy_(found)


def high_order(values: Tensor) -> Tensor:
    """Lines' values (2, K) less their low-order part, which may as well be the scene's."""
    count = values.shape[1]
    along = torch.linspace(-1, 1, count, dtype=values.dtype, device=values.device)
    basis = torch.linalg.qr(torch.linalg.vander(along, N=min(LOW_ORDER_DEGREE, count // 8) + 1)).Q
    return values - values @ basis @ basis.T


@register("effect", "sensor_pattern")
@dataclass(frozen=True)
class SensorPattern(Effect):
    """The standard deviations of the parts of gain and offset, by marginal likelihood."""

    of_sensor = True

    def reject(self, estimate: InitialEstimate) -> None:
        if estimate.step == 1:
            start_parts(estimate.problem, estimate.residual)

    @torch.no_grad()
    def update(self, problem: Problem, *, settled: bool) -> bool:
        """Carry what gain and offset have in common over to the scenes, and estimate the parts.

        Gain and offset are to be about one and zero. The data do not change with it, so nothing but the priors holds
        it, and it drifts.
        """
        values, closed = problem.values(), problem.closed_form()
        unknowns = problem.sensor_unknowns()
        gain, offset = unknowns.get("gain"), unknowns.get("offset")
        for field in dict.fromkeys(each.fields["scene"] for each in (problem, *problem.same_sensor)):
            scene = field()
            if gain in closed:
                scene = scene * values[gain].mean()
            if offset in closed:
                scene = scene + values[offset].mean()
            field.init_from(scene)
        update_parts(problem)
        return False


def _likeliest(problem: Problem, margin: float) -> float | None:
    """The likeliest level, in the data's units from their zero; None where that is not likelier by so many nats."""
    last = problem.operator.named()[-1][1]
    closed = problem.closed_form()
    if not isinstance(last, Sensor) or last.reference is not None or len(closed) < 2:
        return None
    if problem.agc or problem.saturation is not None:  # pictures, and pixels whose range is cut off
        return None
    values = problem.values()
    parts, information, means = next(problem.solved(values, closed).information_blocks())
    known = [part for part in parts if part and not part.constant_axes and not part.sigma_is_fixed and part.sigma > 0]
    if len(known) < 2 or not _follows_level(problem, values):
        return None
    sigma = torch.stack([part.sigma.double() for part in known])
    reference = float(problem.reference)
    data = problem.data[problem.precision > 0].double().cpu().numpy() + reference

    def nats(level: float) -> float:
        return reference_level_nats(information, means, sigma, level - reference)

    low, high = min(0.0, float(data.min())), max(0.0, float(data.max()))
    levels = sorted({low, 0.0, high, *np.multiply(SHARES, data.mean()), *np.quantile(data, QUANTILES)})
    best = int(np.argmin([nats(level) for level in levels]))
    bounds = levels[max(best - 1, 0)], levels[min(best + 1, len(levels) - 1)]
    found = minimize_scalar(
        nats, bounds=bounds, method="bounded", options={"xatol": LEVEL_PRECISION * float(data.std())}
    )
    return float(found.x) if found.fun < nats(reference) - margin else None


def _follows_level(problem: Problem, values: Values) -> bool:
    """Whether a scene that is brighter by some constant makes the flux brighter by that, wherever samples count."""
    unit = float(problem.data.std())
    more = problem.flux(values | {"scene": values["scene"] + unit}) - problem.flux(values)
    wrong: Tensor = (more / unit - 1).abs()[problem.precision > 0] > LEVEL_TOLERANCE
    return bool(wrong.float().mean() < EXCEPTIONS_SHARE)


@register("effect", "reference_level")
@dataclass(frozen=True)
class ReferenceLevel(Effect):
    """The level of the data at which gain and offset are independent of each other."""

    compares_frames = True
    of_sensor = True

    @torch.no_grad()
    def update(self, problem: Problem, *, settled: bool) -> bool:
        """Measure the data from the likeliest level.

        Another level after the first round starts scene, gain and offset anew. Later, and where data sets share one
        sensor, they go on from where they are.
        """
        known, goes_on = bool(problem.reference), bool(settled or problem.same_sensor)
        if goes_on and not (known or problem.same_sensor):
            return False
        level = _likeliest(problem, REFINEMENT_MARGIN if goes_on and known else EVIDENCE_MARGIN)
        if level is None:
            return False
        if not goes_on:
            far = abs(level) >= MIN_DEVIATIONS * float(problem.data[problem.precision > 0].std())
            if far:
                problem.measure_from(level)
            return far
        change = level - float(problem.reference)
        data_sets = (problem, *problem.same_sensor)
        for scene in dict.fromkeys(each.fields["scene"] for each in data_sets):
            scene.init_from(scene() - change)
        for each in data_sets:
            each.measure_from(level)
        update_parts(problem)
        return False
