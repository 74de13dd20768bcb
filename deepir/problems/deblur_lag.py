"""Thermal lag."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from deepir.operators import Lag
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.registry import register
from deepir.solve import Stage

FAST = 1.0  # px between two instants from which the flux in between is a guess
UNLIKE = 1.5  # misfit of the first frame, in those of the others, from which it began otherwise than supposed


@register("problem", "deblur_lag")
class DeblurLag(NUC):
    """Scene, time constant, gain, offset and motion from a burst of a camera that moves smoothly.

    As in `nuc`; but motion and time constant take part from the second round on. What registers is where
    the frames' tails have their weight, so that either is worth little without the other.
    """

    frames = 3
    ordered = True
    operators = ("warp", "lag", "sensor")
    late = ("motion", "tau")

    def initialise(self, problem: Problem, seed: int) -> None:
        """As in `nuc`, from where the camera was when each frame was read."""
        start_motion(problem)
        super().initialise(problem, seed)

    def plan(self, problem: Problem) -> list[Stage]:
        """Sensor, sensor with motion and time constant twice, scene."""
        first, second, third, scene = super().plan(problem)
        return [first, replace(second, steps=third.steps, iterations=third.iterations), third, scene]

    def remarks(self, problem: Problem) -> list[str]:
        """Where the camera moves too fast for the sub-steps, or was not at rest before the first frame."""
        return speed_message(problem) + start_message(problem)


def lag_of(problem: Problem) -> tuple[Lag, Tensor]:
    """The lag, and the mean of its time constants as a map of one pixel."""
    name, lag = next((name, each) for name, each in problem.operator.named() if isinstance(each, Lag))
    return lag, problem.values()[problem.slots[f"{name}.tau"]].mean()[None, None, None, None]


@torch.no_grad()
def start_motion(problem: Problem) -> None:
    """Start the motion where the camera was as each frame was read: what registers lags behind as the pixels do."""
    lag, tau = lag_of(problem)
    seen = problem.values()["motion"].double()
    frames = torch.eye(len(seen), dtype=torch.float64, device=seen.device)
    late = lag(lag.path.through(frames)[:, None, None], tau=tau.double())[:, 0, 0]
    problem.fields["motion"].init_from(torch.linalg.solve(late, seen.flatten(1)).view_as(seen))


@torch.no_grad()
def speed_message(problem: Problem) -> list[str]:
    """A line if the camera moves by more than a pixel from instant to instant."""
    lag, _ = lag_of(problem)
    ways = problem.values()["motion"][:, :2, 2].diff(dim=0).norm(dim=1)
    fastest = float(ways.max())
    if fastest < FAST * lag.path.steps:
        return []
    return [
        f"the camera moves by {fastest:.1f} px from one frame to the next: take physics.lag.substeps="
        f"{int(fastest / FAST) + 1}, or move more slowly"
    ]


@torch.no_grad()
def start_message(problem: Problem) -> list[str]:
    """A line if the first frame misfits more than the others."""
    lag, _ = lag_of(problem)
    misfit = (problem.data - problem.predict(problem.values())).abs().where(problem.precision > 0, torch.nan)
    first, *others = misfit.flatten(1).nanmedian(1).values
    if not first > UNLIKE * torch.stack(others).nanmedian():
        return []
    other = "rest" if lag.path.lead else "moving"
    return [
        "the first frame does not fit the others: what did the camera do before it? "
        f"Try physics.lag.start={other}, or leave the first frames out with data.frames"
    ]
