"""Temporal row and column noise: its variance from the means of the residuals along the lines."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import torch
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.arrays.statistics import masked_values, median, median_sigma
from deepir.effects.effect import Effect, Rounds
from deepir.estimation.residuals import has_line_noise, line_noise_fields
from deepir.fields.line_noise import LineNoise
from deepir.messages import Message
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule, Step

MIN_FRAMES = 3  # a scene and a pattern explain any two values of a line
MIN_VARIANCE_RATIO = 3.0  # variance of lines' means to that of the difference of their halves, if lines jump
LONG_LINE = 80  # for shorter lines, px, that ratio grows with the square: one edge of the scene lies in both halves
MIN_JUMP = 0.1  # standard deviation of jumps that matter, in those of a sample's noise


@torch.no_grad()
def estimate_line_noise(problem: Problem) -> None:
    """Set the standard deviation of the jumps of lines, and each jump to its posterior mean.

    A line that jumps does so in both its halves, unlike noise and model errors. Scene and fixed pattern explain two of
    the n values of a line, so that `(n - 2) / n` of the variance of the jumps is left.
    """
    fields = line_noise_fields(problem)
    for field in fields:
        field.newly_detected = False
    if not fields or len(problem.data) < MIN_FRAMES:
        return
    residual, precision = problem.data - problem.predict(problem.values()), problem.fitted()
    for field in fields:
        mean, apart, known, white = _means(residual, precision, field)
        if field.sigma_is_fixed:
            variance = float(field.sigma) ** 2
        else:
            whole, chance = (_variance(each, known, field.line_axis) for each in (mean, apart))
            variance = (whole - chance) * len(mean) / (len(mean) - 2)
            least = MIN_JUMP**2 * white * residual.shape[field.constant_axes[0]]
            certain = MIN_VARIANCE_RATIO * max(1.0, LONG_LINE / residual.shape[field.constant_axes[0]]) ** 2
            variance = variance if whole > certain * chance and variance > least else 0.0
            field.newly_detected = bool(variance) and not field.sigma > 0
            field.sigma.fill_(variance**0.5)
        field.preconditioning_scale.fill_(white**0.5)
        field.values.copy_(mean * variance / (variance + white) / field.preconditioning_scale)


def _means(residual: Tensor, precision: Tensor, field: LineNoise) -> tuple[Tensor, Tensor, Tensor, float]:
    """Each line's mean above what is predicted without jumps, zero where it is not known; half of what its two halves
    differ by; where both are known; and the variance that white noise leaves in a mean."""
    along = field.constant_axes[0]
    side = residual.shape[along]
    (a, b), (u, v) = (
        [part.sum(along, keepdim=True) for part in each.split([side // 2, side - side // 2], along)]
        for each in (precision * residual, precision)
    )
    total, least = u + v, torch.finfo(u.dtype).tiny
    mean = ((a + b) / total.clamp(min=least) + field() - field.neutral) * (total > 0)
    apart = (a / u.clamp(min=least) - b / v.clamp(min=least)) / 2
    return mean, apart, (u > 0) & (v > 0), 1 / median(masked_values(total, total > 0))


def _variance(values: Tensor, known: Tensor, across: int) -> float:
    """Variance of values of neighbouring lines, without low-order changes across them and outliers."""
    count = known.shape[across] - 1
    both = known.narrow(across, 1, count) & known.narrow(across, 0, count)
    return (MAD_TO_SIGMA * median(masked_values(values.diff(dim=across), both).abs())) ** 2 / 2


@register("effect", "line_noise")
@dataclasses.dataclass(frozen=True)
class TemporalLineNoise(Effect):
    """Rows and columns that jump from frame to frame."""

    def update(self, problem: Problem, *, settled: bool) -> bool:
        estimate_line_noise(problem)
        return False

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        """Where lines jump, the jumps follow the scene in its stage.

        What the jumps of all frames have in common along a line of the scene, only the scene's penalties separate from
        it.
        """
        if not line_noise_fields(problem):
            return schedule
        scene, level = schedule("scene"), problem.sensor_unknowns()["level"]
        step = Step((*scene.steps[0].group, *([level] if level in problem.free() else [])))
        alone = dataclasses.replace(scene, needed=lambda it: not has_line_noise(it))
        lines = dataclasses.replace(scene, name="scene and lines", steps=(step,), needed=has_line_noise)
        return schedule.replaced("scene", alone, lines)

    @torch.no_grad()
    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        noise = median_sigma(problem.precision)
        for field in line_noise_fields(problem):
            if (sigma := float(field.sigma)) > 0:
                yield Message(
                    "line-noise",
                    f"{field.line_name} jump by {sigma:.3g} from frame to frame, {sigma / noise:.2g} times a sample's "
                    "noise: estimated and taken out",
                )
