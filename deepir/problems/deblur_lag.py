"""Thermal lag."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import replace
from typing import ClassVar

import torch

from deepir.assembly import PIXELS_WITH_TV, build_scene
from deepir.fields.base import Scalar
from deepir.messages import Message
from deepir.operators import Lag, Warp
from deepir.operators.base import Trajectory
from deepir.optim.low_order_model import apply_lag
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.problems.recipe import TRIAL_ITERATIONS
from deepir.registry import register
from deepir.schedule import Schedule, Stage

MAX_MOTION_PER_SUBSTEP = 1.0  # px: above, the flux between two instants is a guess
MAX_SUBSTEPS = 16  # more mean that the camera jumps
HALF_SPEED = 0.5  # of the speed after the first frame
FIRST_FRAME_MISFIT = 1.15  # residual of the first frame relative to that of the others, that is reported


@register("problem", "deblur_lag")
class DeblurLag(NUC):
    """Scene, time constant, gain, offset and motion from frames of a camera that moves smoothly.

    As in `nuc`, but motion and time constant take part from the second round on: as registered, the motion is that of
    the tails, which differs by what the camera moves in a time constant. Whether the camera was moving before the first
    frame is tried both ways.
    """

    judged = False

    frames = 3
    ordered = True
    operators: ClassVar[tuple[str, ...]] = ("warp", "lag", "sensor")

    def initialise(self, problem: Problem, seed: int) -> None:
        """As in `nuc`, from where the camera was as each frame was read."""
        name = slot_of(problem, "moving")
        if name in problem.free():
            losses = [self._tried(copy.deepcopy(problem), share, seed) for share in (0.0, 1.0)]
            hold(problem, float(losses[1] < losses[0]))
        start_motion(problem)
        super().initialise(problem, seed)

    def _tried(self, problem: Problem, share: float, seed: int) -> float:
        """The objective, in nats, that a few iterations come to with this speed before the first frame.

        Of free pixels, whatever the scene's prior: a network would take its time.
        """
        hold(problem, share)
        problem.represent("scene", *build_scene(PIXELS_WITH_TV, problem.fields["scene"].shape))
        problem.to(problem.data.device)
        self.initialise(problem, seed)
        steps = self.plan(problem)("sensor 2").steps
        return float(solve(problem, [Stage("before", steps, TRIAL_ITERATIONS)]).history[-1]["loss"])

    def plan(self, problem: Problem) -> Schedule:
        """Sensor; with motion and time constant, twice, to the end; scene."""
        schedule = super().plan(problem)
        last = replace(schedule("sensor 3"), tolerance=Stage.tolerance)
        return schedule.replaced("sensor 2", replace(last, name="sensor 2")).replaced("sensor 3", last)

    def waiting(self, problem: Problem) -> tuple[str, ...]:
        """The motion and the time constant."""
        return problem.motion_unknown(), slot_of(problem, "tau")

    @torch.no_grad()
    def metrics(self, problem: Problem) -> dict[str, float]:
        """The mean time constant, ms, and how fast the camera was before the first frame, 0 to 1."""
        values = problem.values()
        tau, moving = (float(values[slot_of(problem, slot)].mean()) for slot in ("tau", "moving"))
        return {"tau_ms": tau, "moving_before": moving}

    def warnings(self, problem: Problem, *, complete: bool = True) -> list[str]:
        """Where the sub-steps are too few, or the camera did something else before the first frame."""
        found = super().warnings(problem, complete=complete)
        return [*speed_message(problem), *start_message(problem), *found]


def slot_of(problem: Problem, slot: str) -> str:
    """The unknown that is bound to one of the lag's slots."""
    stage = next(name for name, stage in problem.operator.named() if isinstance(stage, Lag))
    return problem.slots[f"{stage}.{slot}"]


@torch.no_grad()
def hold(problem: Problem, share: float) -> None:
    """Fix how fast the camera was before the first frame, in parts of the speed at which it goes on."""
    field = problem.fields[slot_of(problem, "moving")]
    field.init_from(torch.full(field.shape, share))
    field.requires_grad_(False)


@torch.no_grad()
def start_motion(problem: Problem) -> None:
    """Start the motion where the camera was as each frame was read: what is registered lags behind as the pixels do."""
    field = problem.field_of(problem.slot(Warp, "motion"))
    seen = field().double()
    frames = torch.eye(len(seen), dtype=seen.dtype, device=seen.device)
    lag = apply_lag(problem, path_of(problem).interpolate(frames))
    field.init_from(torch.linalg.solve(lag, seen.flatten(1)).view_as(seen))


def path_of(problem: Problem) -> Trajectory:
    """The instants at which the warp shows the scene."""
    return next(stage.instants for _, stage in problem.operator.named() if isinstance(stage, Warp))


@torch.no_grad()
def speed_message(problem: Problem) -> Iterator[str]:
    """A line if the camera moves by more than a pixel from instant to instant."""
    fastest = float(problem.field_of(problem.slot(Warp, "motion"))()[:, :2, 2].diff(dim=0).norm(dim=1).max())
    if fastest < MAX_MOTION_PER_SUBSTEP * path_of(problem).steps:
        return
    enough = int(fastest / MAX_MOTION_PER_SUBSTEP) + 1
    remedy = (
        f"take physics.lag.substeps={enough}, or move more slowly"
        if enough <= MAX_SUBSTEPS
        else "where it was in between is not known. Move more slowly; if it jumped and stood still, take problem 'nuc'"
    )
    yield Message("lag-motion-fast", f"the camera moves by up to {fastest:.1f} px from one frame to the next: {remedy}")


@torch.no_grad()
def start_message(problem: Problem) -> Iterator[str]:
    """A line if the first frame misfits more than the others."""
    misfit = (problem.data - problem.predict(problem.values())).abs().where(problem.precision > 0, torch.nan)
    first, *others = misfit.flatten(1).nanmedian(1).values
    if not first > FIRST_FRAME_MISFIT * torch.stack(others).nanmedian():
        return
    moving = problem.fields[slot_of(problem, "moving")]
    other = int(float(moving().mean()) < HALF_SPEED)
    remedy = (
        "Neither rest nor moving as it goes on fits, and the next frames hold some of it still: leave the first ones "
        "out (data.frames=2:)"
        if isinstance(moving, Scalar)  # both were tried
        else f"Try physics.lag.moving={other}, or leave the first frames out (data.frames=2:)"
    )
    yield Message(
        "lag-first-frame", f"the first frame does not fit the others: what did the camera do before it? {remedy}"
    )
