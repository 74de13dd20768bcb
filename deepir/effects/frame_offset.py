"""Frame offsets: detection at the start, and the drift message."""

from __future__ import annotations

from collections.abc import Iterator
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
START_LEVEL = 2.0  # level, in standard deviations of what the average leaves, that the initial estimate corrects


@torch.no_grad()
def frame_levels(problem: Problem) -> tuple[Tensor, float]:
    """Levels of the frames above their prediction, by medians, mean zero, (N, 1, 1, 1); the deviation of the rest."""
    data, precision, expected = subsample(problem.data, problem.precision, problem.predict(problem.values()))
    rest, known = data - expected, precision > 0
    level = rest.where(known, torch.nan).nanmedian(1, keepdim=True).values.nan_to_num()
    level -= level.mean()
    return level[..., None, None], float(masked_values(rest - level, known).std())


@register("effect", "frame_offset")
@dataclass(frozen=True)
class FrameOffset(Effect):
    """The level of each frame, where it stands out of all that the average of the frames leaves."""

    @torch.no_grad()
    def equalise(self, problem: Problem) -> bool:
        """Add levels that exceed `START_LEVEL` residual standard deviations to the known drift.

        Levels that differ much between frames leave the borders of the frames as edges in their registered average.
        """
        name = problem.sensor_unknowns().get("level", "")
        fields = problem.fields[name].modules() if name in problem.free() else ()
        drift = next((each for each in fields if isinstance(each, Drift) and not each.sigma_is_fixed), None)
        if drift is None:
            return False
        level, spread = frame_levels(problem)
        if not float(level.abs().max()) > START_LEVEL * spread:
            return False
        drift.level_offsets.add_(level)
        return True

    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        """Say so if the frames' levels drift, whether the problem knows it or not."""
        least = REPORTED_DRIFT * median_sigma(problem.precision)
        name = problem.sensor_unknowns().get("level", "")
        if not (complete and name):
            return
        if name in problem.free():
            found = problem.fields[name]().detach().mean((1, 2, 3))
            chance = sum(each.frame_mean_variance for each in problem.modules() if isinstance(each, LineNoise))
            if float((found - found.mean()).abs().max()) > least + CHANCE_DRIFT * chance**0.5:
                yield Message(
                    "level-drift",
                    f"the level of whole frames drifts, by {found.std():.3g}: "
                    "a slope across the scene is separated from that only in part",
                )
        elif (drift := float(frame_levels(problem)[0].abs().max())) >= least:
            yield Message(
                "level-drift-ignored",
                f"the level of whole frames drifts, by {drift:.3g} or more: estimate it, with "
                "physics.sensor.level=drift",
            )
