"""The same burst at half its size, which tells how the camera moved where the whole one has it wrong."""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.build import build
from deepir.burst import Burst
from deepir.config import load
from deepir.operators import Sensor, Warp
from deepir.priors.field import Field
from deepir.priors.motion import Auto, Motion
from deepir.problem import Problem
from deepir.solve import solve
from deepir.stage import Stage
from deepir.strengths import pattern_left

SOME = slice(1, -1, 3)  # samples along an axis that are enough for a step
#: Weights along an axis, binomial. Means of two leave waves too short for the half, which the scene can follow
#: in the first frame only, whose pixels are its own: all others then lie 0.3 px off, together.
SMOOTH = (1, 7, 21, 35, 35, 21, 7, 1)
FEWEST, BENDS = 3, 1200.0  # frames that may bend, and nats by which that is the likelier
KNOWN = 0.5  # of a sample's weight, to count


@torch.no_grad()
def step_asked(problem: Problem) -> float:
    """How far a frame asks to be moved at most: by shift and turn together, px at its corners.

    By one step of Gauss and Newton towards the frames less what stands still in them, from the scene as it is. Zero
    where there is more before the sensor than a camera that moves, and where its motion is fixed.
    """
    stages = [type(stage) for _, stage in problem.operator.named()]
    if stages != [Warp, Sensor] or not _is_free(_field(problem)):
        return 0.0
    values = problem.values()
    flux, rest = problem.flux(values), problem.data - problem.predict(values)
    rest -= pattern_left(rest, problem.precision / problem.precision.amax())
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


def halved(problem: Problem) -> Problem:
    """The same burst on every second row and column, smoothed, before a sensor of columns, rows and pixels."""
    usable = (problem.precision > 0).to(problem.data)
    share = _smaller(usable)
    mean = _smaller(usable * problem.data) / share.clamp(min=1e-6)
    valid = (share >= KNOWN)[:, 0].cpu().numpy()
    frames = np.where(valid, mean[:, 0].cpu().numpy(), 0)
    field, twice = _field(problem), _from_half(problem)
    motion = torch.linalg.solve(twice, field().detach().double().cpu() @ twice)
    config = load("nuc", [f"physics.warp.motion.type={type(field).model}", "prior=tv"])
    half, _ = build(config, Burst(frames, valid, np.asarray(~valid.any(0))), motion)
    return half.to(problem.data.device)


@torch.no_grad()
def take_motion(problem: Problem, half: Problem) -> None:
    """Let a burst move as its half does."""
    twice = _from_half(problem)
    motion = twice @ _field(half)().double().cpu() @ torch.linalg.inv(twice)
    _field(problem).init_from(motion.to(problem.data.device))


@torch.no_grad()
def take_moving(problem: Problem, half: Problem) -> None:
    """Let the samples of a burst show what moves by itself where those of its half do."""
    twice = half.moving.repeat_interleave(2, -2).repeat_interleave(2, -1)
    problem.moving.zero_()
    problem.moving[..., : twice.shape[-2], : twice.shape[-1]] = twice.to(problem.moving.device)


def bent(half: Problem, last: Stage) -> Problem | None:
    """The half with homographies, solved, if its frames bend; None if they do not, or did already.

    Both go on with the `last` round, at its strengths, to see how much likelier homographies are.
    """
    bends = copy.deepcopy(half)
    field = _field(bends)
    if not isinstance(field, Auto) or field.bends or len(half.data) < FEWEST:
        return None
    field.bend()
    going_on = replace(last, prepare=None)
    rigid, free = (solve(each, [going_on]).history[-1]["loss"] for each in (half, bends))
    if rigid - free < BENDS:
        return None
    solve(bends, [last])
    return bends


def _smaller(frames: Tensor) -> Tensor:
    """Frames (N, 1, h, w), zero beyond, between each two rows and columns: (N, 1, h // 2, w // 2)."""
    weights = torch.tensor(SMOOTH).to(frames) / sum(SMOOTH)
    h, w = (2 * (side // 2) for side in frames.shape[-2:])
    reach = len(SMOOTH) // 2 - 1
    down = F.conv2d(
        frames[..., :h, :w], weights[:, None].expand(1, 1, -1, 1), stride=(2, 1), padding=(reach, 0)
    )
    return F.conv2d(down, weights.expand(1, 1, 1, -1), stride=(1, 2), padding=(0, reach))


def _field(problem: Problem) -> Field:
    return problem.fields[problem.slots[f"{problem.operator.named()[0][0]}.motion"]]


def _is_free(field: Field) -> bool:
    return isinstance(field, Motion) and any(p.requires_grad for p in field.parameters())


def _from_half(problem: Problem) -> Tensor:
    """Points of the half to those of the whole, (3, 3), each about its centre; an odd last line is left out."""
    h, w = (side % 2 / 2 for side in problem.data.shape[-2:])
    return torch.tensor([[2, 0, -w], [0, 2, -h], [0, 0, 1]], dtype=torch.float64)
