"""Levels of whole frames: whether they drift, or whether the camera moves over shading.

A camera that moves by `d` over a slope of the sensor sees its level change by a multiple of `d`, as if it drifted. But
shading is never a slope alone: what it does to a frame has a slope of its own, and that no drift has.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.noise import typical_noise
from deepir.priors.motion import Motion
from deepir.problem import Problem
from deepir.thin import thinned

#: Levels, in standard deviations of a sample's noise, above which they drift. With all modelled they are at most 0.1.
DRIFT = 0.25
ENOUGH = 5  # frames to tell a drift from a slope of shading
CHANCE = 2.0  # standard deviations of what the lines' pattern does to the levels, above which they drift
TILTED = 0.6  # ratio of the frames' tilts to their levels above which it is shading that moves the levels
OUTLIER = 5.0  # standard deviations at which a sample is cut off


@torch.no_grad()
def level_residuals(problem: Problem) -> Tensor:
    """How far each frame as a whole is above its prediction, (N, 1, 1, 1): the median over its usable samples."""
    data, precision, expected = thinned(problem.data, problem.precision, problem.predict(problem.values()))
    rest = (data - expected).where(precision > 0, torch.nan)
    return rest.nanmedian(1).values.nan_to_num()[:, None, None, None]


@torch.no_grad()
def tilt(problem: Problem) -> float:
    """How much the frames slope against each other beyond their prediction: root mean square, at the frame's edge."""
    usable = problem.precision > 0
    rest = problem.data - problem.predict(problem.values())
    rest = rest - (rest * usable).sum(0) / usable.sum(0).clamp(min=1)
    some, counts = thinned(rest, usable)
    limit = OUTLIER * 1.5 * some[counts].abs().median()
    rest = (rest - level_residuals(problem)).clamp(-limit, limit) * usable
    slopes = []
    for axis in (-1, -2):
        ramp = torch.linspace(-1, 1, rest.shape[axis], device=rest.device)
        slopes.append(3 * (rest.mean(-3 - axis, keepdim=True).squeeze() * ramp).mean(-1))
    return float(torch.stack(slopes).square().sum(0).mean().sqrt())


def shifts(problem: Problem) -> Tensor:
    """Translation (x, y) of each frame, (N, 2) float64, less their mean; zero without motion."""
    values = [field() for name in problem.slots.values() if isinstance(field := problem.fields[name], Motion)]
    if not values:
        return problem.data.new_zeros(len(problem.data), 2).double()
    moved = values[0][:, :2, 2].detach().double()
    return moved - moved.mean(0)


def reach(problem: Problem) -> float:
    """How far the camera moves, root mean square over the frames, as a share of half the frame's shorter side."""
    return float(shifts(problem).square().sum(1).mean().sqrt()) / (min(problem.data.shape[-2:]) / 2)


@torch.no_grad()
def drift_strength(problem: Problem, levels: Tensor) -> float:
    """Standard deviation of the levels if they drift; zero if they do not, or if shading moves them.

    From five frames on, what no slope of shading explains is drift. With fewer, it is shading if the frames tilt.
    """
    levels = levels.flatten().double()
    levels = levels - levels.mean()
    strength, drift = float(levels.std()), float(levels.std())
    if len(levels) >= ENOUGH:
        moved = shifts(problem)
        rest = levels - moved @ torch.linalg.lstsq(moved, levels[:, None]).solution[:, 0]
        drift = float((rest.square().sum() / (len(levels) - 3)).sqrt())
    elif tilt(problem) > TILTED * strength:
        return 0.0
    noise = typical_noise(problem.precision)
    return strength if drift > max(DRIFT * noise, CHANCE * chance(problem)) else 0.0


def chance(problem: Problem) -> float:
    """How much the mean of the lines' pattern changes by chance where the camera moves, in the data's units.

    Of lines at one edge of the view some leave, and as many others enter at the other.
    """
    usable = problem.precision > 0
    rest = (problem.data - problem.predict(problem.values())) * usable
    pattern = rest.sum(0) / usable.sum(0).clamp(min=1)
    moved = shifts(problem).abs().mean(0)
    total = 0.0
    for axis, distance in zip((-1, -2), moved, strict=True):
        lines = pattern.mean(-3 - axis).flatten()
        total += float(lines.diff().square().mean() / 2 * 2 * distance) / len(lines) ** 2
    return total**0.5


def drift_message(problem: Problem) -> list[str]:
    """Say so if the frames' levels drift, whether the problem knows it or not."""
    if all(name in problem.free() for name in level_names(problem)):
        found = [float(problem.fields[name]().detach().std()) for name in level_names(problem)]
        return [
            f"the level of whole frames drifts, by {each:.3g}: a slope across the scene is told from that only in part"
            for each in found
            if each > 0
        ]
    level = level_residuals(problem)
    drift = float((level - level.mean()).abs().max())
    noise = typical_noise(problem.precision)
    if drift < DRIFT * noise:
        return []
    return [
        f"the level of whole frames drifts, by {drift:.3g} or more: estimate it, with physics.sensor.level=drift"
    ]


def level_names(problem: Problem) -> list[str]:
    """The unknowns that are bound to a sensor's level."""
    return [name for slot, name in problem.slots.items() if slot.rpartition(".")[2] == "level"]
