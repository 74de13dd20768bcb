"""Thermal lag."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import torch

from deepir.operators.path import Path
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.registry import register
from deepir.slow import late
from deepir.solve import Stage

FAST = 1.0  # px from instant to instant, above which the flux in between is a guess
UNLIKE = (
    1.15  # misfit of the first frame, in those of the others, from which it began otherwise than supposed
)


@register("problem", "deblur_lag")
class DeblurLag(NUC):
    """Scene, time constant, gain, offset and motion from frames of a camera that moves smoothly.

    As in `nuc`, but motion and time constant take part from the second round on: as registered, the motion is that of
    the tails, which differs by what the camera moves in a time constant.
    """

    frames = 3
    ordered = True
    operators: ClassVar[tuple[str, ...]] = ("warp", "lag", "sensor")
    late: ClassVar[tuple[str, ...]] = ("motion", "tau")

    def initialise(self, problem: Problem, seed: int) -> None:
        """As in `nuc`, from where the camera was as each frame was read."""
        start_motion(problem)
        super().initialise(problem, seed)

    def plan(self, problem: Problem) -> list[Stage]:
        """Sensor; with motion and time constant, twice; scene."""
        first, second, third, scene = super().plan(problem)
        return [first, replace(second, steps=third.steps, iterations=third.iterations), third, scene]

    def remarks(self, problem: Problem) -> list[str]:
        """Where the sub-steps are too few, or the camera did something else before the first frame."""
        return speed_message(problem) + start_message(problem)


@torch.no_grad()
def start_motion(problem: Problem) -> None:
    """Start the motion where the camera was as each frame was read: what is registered lags behind as the pixels do."""
    field = problem.fields["motion"]
    seen = field().double()
    frames = torch.eye(len(seen), dtype=seen.dtype, device=seen.device)
    field.init_from(
        torch.linalg.solve(late(problem, path_of(problem).through(frames)), seen.flatten(1)).view_as(seen)
    )


def path_of(problem: Problem) -> Path:
    """The instants at which the warp shows the scene."""
    path: Path = problem.operator.stages["warp"].instants  # type: ignore[assignment]
    return path


@torch.no_grad()
def speed_message(problem: Problem) -> list[str]:
    """A line if the camera moves by more than a pixel from instant to instant."""
    fastest = float(problem.fields["motion"]()[:, :2, 2].diff(dim=0).norm(dim=1).max())
    if fastest < FAST * path_of(problem).steps:
        return []
    return [
        f"the camera moves by up to {fastest:.1f} px from one frame to the next: "
        f"take physics.lag.substeps={int(fastest / FAST) + 1}, or move more slowly"
    ]


@torch.no_grad()
def start_message(problem: Problem) -> list[str]:
    """A line if the first frame misfits more than the others."""
    misfit = (problem.data - problem.predict(problem.values())).abs().where(problem.precision > 0, torch.nan)
    first, *others = misfit.flatten(1).nanmedian(1).values
    if not first > UNLIKE * torch.stack(others).nanmedian():
        return []
    other = "rest" if path_of(problem).lead else "moving"
    return [
        "the first frame does not fit the others: what did the camera do before it? "
        f"Try physics.lag.start={other}, or leave the first frames out (data.frames)"
    ]
