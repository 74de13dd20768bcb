"""Drift of the gain from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.effects.effect import Effect, Rounds
from deepir.effects.frame_gain import contrast_slopes
from deepir.estimation.gain_offset_evidence import GainOffsetEvidence
from deepir.problem import Problem
from deepir.registry import register
from deepir.schedule import Schedule

POLYNOMIAL_DEGREE = 2  # of the low-order part of a block
GRID, MAX_SAMPLES = 3, 40_000  # blocks along each axis; samples of a frame that are used
#: Standard errors by which the blocks' gains differ from frame to frame if the response drifts. A camera that does not
#: drift has 5.6 at most, mostly 1 to 3.
MIN_DEVIATION = 6.0
MIN_DRIFT = 2e-4  # relative change of the gain
MIN_BLOCKS = 2  # effective number of blocks, less one


@register("effect", "gain_drift")
@dataclass(frozen=True)
class GainDrift(Effect):
    """A response that drifts from frame to frame, as a camera that warms up has it."""

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
def detect_gain_drift(problem: Problem) -> bool:
    """Whether the gain drifts from frame to frame: whether the blocks of a frame agree on a deviation.

    Valid where scene and pattern have converged. A moving object is in one block or two.
    """
    if problem.stretched:
        return False
    slopes, weights = _parts(problem, problem.predict(problem.values()))
    each = slopes / slopes.mean(0) - 1
    found = (weights * each).sum(1) / weights.sum()
    spread = (weights * (each - found[:, None]).square()).sum(1) / weights.sum()
    free = weights.sum().square() / weights.square().sum() - 1  # of as many parts as count
    apart = (found.square() * free / spread).mean().sqrt()
    return bool(free > MIN_BLOCKS and apart > MIN_DEVIATION and found.abs().max() > MIN_DRIFT)


@torch.no_grad()
def correct_gain_drift(problem: Problem) -> None:
    """Divide the frames by the estimated gains."""
    problem.divide_frames(GainOffsetEvidence(problem, contrasts=True).contrasts())


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
