"""How far the start asks the frames to be moved."""

from __future__ import annotations

import math

import torch

from deepir.estimation.residuals import temporal_mean
from deepir.fields.base import Field
from deepir.fields.motion import Motion
from deepir.operators import Sensor, Warp
from deepir.problem import Problem

SOME = slice(1, -1, 3)  # samples along an axis that are enough for a step


def motion_of(problem: Problem) -> Field:
    """The field of how the camera moved, where its warp comes first."""
    return problem.field_of(f"{problem.operator.named()[0][0]}.motion")


@torch.no_grad()
def gauss_newton_motion_step(problem: Problem) -> float:
    """How far a frame asks to be moved at most: by shift and turn together, px at its corners.

    By one step of Gauss and Newton towards the frames less what stands still in them, from the scene as it is. Zero
    where there is more before the sensor than a camera that moves, and where its motion is fixed.
    """
    stages = [type(stage) for _, stage in problem.operator.named()]
    if stages != [Warp, Sensor] or not _is_free(motion_of(problem)):
        return 0.0
    values = problem.values()
    flux, rest = problem.flux(values), problem.data - problem.predict(values)
    rest -= temporal_mean(rest, problem.precision / problem.precision.amax())
    across, down = ((flux.roll(-1, axis) - flux.roll(1, axis))[1:, 0, SOME, SOME] / 2 for axis in (-1, -2))
    h, w = flux.shape[-2:]
    y, x = (torch.arange(side, device=flux.device)[SOME] - (side - 1) / 2 for side in (h, w))
    turn = (down * x - across * y[:, None]) / (math.hypot(h, w) / 2)
    slopes = torch.stack((across, down, turn), 1).double().flatten(2)
    weight, apart = (each[1:, 0, SOME, SOME].double().flatten(1) for each in (problem.precision, rest))
    normal = torch.einsum("kis,ks,kjs->kij", slopes, weight, slopes)
    ridge = 1e-9 * normal.diagonal(dim1=1, dim2=2).mean().clamp(min=1e-30)  # a flat scene asks for nothing
    normal += ridge * torch.eye(3, device=flux.device)
    steps = torch.linalg.solve(normal, torch.einsum("kis,ks,ks->ki", slopes, weight, apart))
    return float(steps.abs().sum(1).max())


def _is_free(field: Field) -> bool:
    return isinstance(field, Motion) and any(p.requires_grad for p in field.parameters())
