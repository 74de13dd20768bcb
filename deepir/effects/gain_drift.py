"""Drift of the gain from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.effects.effect import Effect, Rounds
from deepir.effects.frame_gain import contrast_slopes
from deepir.estimation.low_order_evidence import GainOffsetEvidence, frame_level_offsets
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.fields.drift import Drift
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule

POLYNOMIAL_DEGREE = 2  # of the low-order part of a block
GRID, MAX_SAMPLES = 3, 40_000  # blocks along each axis; samples of a frame that are used
#: Standard errors by which the blocks' gains differ from frame to frame if the response drifts. A camera that does not
#: drift has 5.6 at most, mostly 1 to 3.
MIN_DEVIATION = 6.0
MIN_AGREED_DEVIATION = 2.0  # the same, where the frames' levels say so, too
MIN_DRIFT = 2e-4  # relative change of the gain
MIN_BLOCKS = 2  # effective number of blocks, less one
#: Relative deviation of a frame's level and contrast, and of its contrast alone, from which frames have exposures of
#: their own: a strong pattern that is not found yet makes contrasts differ by 0.04.
MIN_EXPOSURE, MIN_CONTRAST = 0.03, 0.1
#: Difference of exposures by level and by contrast, over their deviation from one, up to which they agree.
MAX_DISAGREEMENT = 0.5
EXPOSURE_TOLERANCE = 1e-4  # relative change that ends the turns


@register("effect", "gain_drift")
@dataclass(frozen=True)
class GainDrift(Effect):
    """A response that drifts from frame to frame, as a camera that warms up has it; or exposures that differ."""

    def equalise(self, problem: Problem) -> bool:
        return even_exposures(problem)

    def plan(self, problem: Problem, schedule: Schedule, rounds: Rounds) -> Schedule:
        def again(problem: Problem) -> None:
            correct_gain_drift(problem)
            rounds.restart(problem)

        def go_on(problem: Problem) -> None:
            correct_gain_drift(problem)
            rounds.update(problem)

        last = schedule("sensor 3")
        return schedule.after(
            last.name,
            *(
                replace(last, name=f"response {i}", needed=detect_gain_drift, prepare=prepare)
                for i, prepare in enumerate((again, go_on, go_on), 1)
            ),
        )


@torch.no_grad()
def even_exposures(problem: Problem) -> bool:
    """Divide frames by their exposures, in the initial estimate, where these differ; whether they were divided.

    The fixed pattern, which is not in the prediction yet, is added to it. An exposure acts on all of the signal: where
    level and contrast of the frames agree on it, they are divided about zero, which leaves no levels to be found.
    """
    if len(problem.data) < 2 or problem.agc:
        return False
    pattern = temporal_mean(fixed_pattern_residual(problem), problem.precision.sign())
    expected, zero = problem.predict(problem.values()) + pattern, -float(problem.reference)
    exposures = _exposures(problem, expected - frame_level_offsets(problem), zero)
    if has_exposures(problem):  # of the turn before
        again = not frame_level_offsets(problem).any() and (exposures - 1).abs().max() > EXPOSURE_TOLERANCE
        if again:
            problem.divide_frames(exposures, zero)
        return bool(again)
    gains, deviation = _frame_gains(problem, expected)
    if (exposures - gains).norm() > MAX_DISAGREEMENT * (gains - 1).norm():
        differ = deviation > MIN_DEVIATION and bool((gains - 1).abs().max() > MIN_CONTRAST)
        if differ:
            problem.divide_frames(gains)
        return differ
    if deviation < MIN_AGREED_DEVIATION or not (exposures - 1).abs().max() > MIN_EXPOSURE:
        return False
    problem.divide_frames(exposures, zero)
    for each in problem.modules():
        if isinstance(each, Drift):
            each.level_offsets.zero_()
    return True


def has_exposures(problem: Problem) -> bool:
    """Whether frames were divided by exposures that differ."""
    return not problem.agc and bool((problem.contrast - 1).abs().max() > MIN_EXPOSURE)


def _exposures(problem: Problem, expected: Tensor, zero: float) -> Tensor:
    """Factors between the frames and their prediction, (N,), of mean one: slopes of a regression through `zero`."""
    shown = expected - zero
    weighted = (shown * problem.precision.sign()).double()
    found = (weighted * (problem.data - zero)).sum((1, 2, 3)) / (weighted * shown).sum((1, 2, 3))
    return found / found.mean()


@torch.no_grad()
def detect_gain_drift(problem: Problem) -> bool:
    """Whether the gain drifts from frame to frame; valid where scene and pattern have converged."""
    if problem.agc:
        return False
    gains, deviation = _frame_gains(problem, problem.predict(problem.values()))
    return deviation > MIN_DEVIATION and bool((gains - 1).abs().max() > MIN_DRIFT)


def _frame_gains(problem: Problem, expected: Tensor) -> tuple[Tensor, float]:
    """Gains of the frames, (N,), of mean one, and their deviation from one in standard errors over the blocks.

    The deviation is zero where few blocks count. A moving object is in one block or two.
    """
    slopes, weights = _parts(problem, expected)
    each = slopes / slopes.mean(0) - 1
    found = (weights * each).sum(1) / weights.sum()
    spread = (weights * (each - found[:, None]).square()).sum(1) / weights.sum()
    free = weights.sum().square() / weights.square().sum() - 1  # of as many parts as count
    apart = (found.square() * free / spread).mean().sqrt()
    return 1 + found, float(apart) if free > MIN_BLOCKS else 0.0


@torch.no_grad()
def correct_gain_drift(problem: Problem) -> None:
    """Divide the frames by the estimated gains."""
    problem.divide_frames(GainOffsetEvidence(problem, frame_gains=True).frame_gains())


def _parts(problem: Problem, expected: Tensor) -> tuple[Tensor, Tensor]:
    """Slopes of the blocks of frames on their prediction, (N, blocks), and the information of each block, (blocks,)."""
    h, w = problem.data.shape[-2:]
    step = max(round((h * w / MAX_SAMPLES) ** 0.5), 1)
    rows, columns = (
        [slice(side * i // GRID, side * (i + 1) // GRID, step) for i in range(GRID)] for side in (h, w)
    )
    given = problem.data, expected, problem.precision
    parts = [[each[:, 0, y, x] for each in given] for y in rows for x in columns]
    found = [contrast_slopes(frames, shown, weight, POLYNOMIAL_DEGREE) for frames, shown, weight in parts]
    slopes, information = (torch.stack(each, 1) for each in zip(*found, strict=True))
    return slopes, information.mean(0)
