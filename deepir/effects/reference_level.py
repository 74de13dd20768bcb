"""The reference level of the sensor: the level of the data at which gain and offset are independent of each other.

Gain and offset have independent priors in the units of the data. That is right for a raw detector, whose gain acts on
all of its signal. Behind a shutter, a correction by the factory, or in the bolometer's own physics the pattern is small
at some level L of the data, and `offset = (1 - gain) L + rest`: the two are correlated. Measured from L, frames obey
the same equation with an offset that is independent of the gain again. So L is estimated by the marginal likelihood of
the pixels' parts (`deepir.estimation.variance_components`), and subtracted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import minimize_scalar
from torch import Tensor

from deepir.effects.effect import Effect
from deepir.effects.sensor_pattern import update_parts
from deepir.estimation.variance_components import reference_level_nats
from deepir.operators import Sensor
from deepir.problem import Problem, Values
from deepir.registry import register

#: Nats of the pixels by which a first reference level other than zero has to be likelier, and a later one.
EVIDENCE_MARGIN, REFINEMENT_MARGIN = 100.0, 2.0
#: Standard deviations of the data by which a first level differs from zero: nearer, it makes little difference.
MIN_DEVIATIONS = 3.0
#: Levels at which the likelihood is compared first: shares of the data's mean, and quantiles of the data.
SHARES, QUANTILES = (0.25, 0.5, 0.75), (0.0, 0.1, 0.5, 0.9, 1.0)
#: Share of the data's standard deviation to which the level is found.
LEVEL_PRECISION = 0.05
#: Relative error up to which the flux follows the scene's level, and share of the samples that may have more.
LEVEL_TOLERANCE, EXCEPTIONS_SHARE = 1e-3, 0.01


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
    known = [
        part
        for part in parts
        if part and not part.constant_axes and not part.sigma_is_fixed and part.sigma > 0
    ]
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
