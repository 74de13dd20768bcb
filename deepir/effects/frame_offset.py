"""Frame offsets: detection at the start, and the drift message."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median_sigma, subsample
from deepir.effects.effect import Effect
from deepir.fields.drift import Drift
from deepir.fields.line_noise import LineNoise
from deepir.messages import Message
from deepir.problem import Problem
from deepir.registry import register

#: Level of a frame, in standard deviations of a sample's noise, that is reported as a drift: 0.1 where all is modelled.
REPORTED_DRIFT = 0.25
CHANCE_DRIFT = 4.0  # the same, in standard deviations of the mean of lines that jump independently
START_LEVEL = (
    2.0  # level, in standard deviations of what the average leaves, that the initial estimate corrects
)


@torch.no_grad()
def level_residuals(problem: Problem) -> Tensor:
    """How far each frame as a whole is above its prediction, (N, 1, 1, 1): the median over its usable samples."""
    data, precision, expected = subsample(problem.data, problem.precision, problem.predict(problem.values()))
    rest = (data - expected).where(precision > 0, torch.nan)
    return rest.nanmedian(1).values.nan_to_num()[:, None, None, None]


@torch.no_grad()
def start_frame_levels(problem: Problem) -> bool:
    """Add frame levels that exceed `START_LEVEL` residual standard deviations to the known drift.

    Levels that differ much between frames leave the borders of the frames as edges in their registered average.

    Returns:
        Whether any do.
    """
    name = problem.sensor_unknowns().get("level", "")
    fields = problem.fields[name].modules() if name in problem.free() else ()
    drifts = [field for field in fields if isinstance(field, Drift) and not field.sigma_is_fixed]
    level = level_residuals(problem)
    level -= level.mean()
    data, precision, expected = subsample(problem.data, problem.precision, problem.predict(problem.values()))
    rest = masked_values(data - expected - level.flatten(1), precision > 0)
    if not drifts or not level.abs().max() > START_LEVEL * rest.std():
        return False
    drifts[0].level_offsets.add_(level)
    return True


@register("effect", "frame_offset")
@dataclass(frozen=True)
class FrameOffset(Effect):
    """The level of each frame, where it stands out of all that the average of the frames leaves."""

    def equalise(self, problem: Problem) -> bool:
        return start_frame_levels(problem)

    def messages(self, problem: Problem, *, complete: bool) -> list[str]:
        """Say so if the frames' levels drift, whether the problem knows it or not."""
        least = REPORTED_DRIFT * median_sigma(problem.precision)
        name = problem.sensor_unknowns().get("level", "")
        if not (complete and name):
            return []
        if name in problem.free():
            found = problem.fields[name]().detach().mean((1, 2, 3))
            chance = sum(
                each.frame_mean_variance for each in problem.modules() if isinstance(each, LineNoise)
            )
            if float((found - found.mean()).abs().max()) <= least + CHANCE_DRIFT * chance**0.5:
                return []
            return [
                Message(
                    "level-drift",
                    f"the level of whole frames drifts, by {found.std():.3g}: "
                    "a slope across the scene is separated from that only in part",
                )
            ]
        level = level_residuals(problem)
        drift = float((level - level.mean()).abs().max())
        if drift < least:
            return []
        return [
            Message(
                "level-drift-ignored",
                f"the level of whole frames drifts, by {drift:.3g} or more: estimate it, with "
                "physics.sensor.level=drift",
            )
        ]
