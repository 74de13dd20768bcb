"""Coarse to fine: motion and moving objects from the burst at half resolution, where the registered motion is wrong."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.assembly.problem import PIXELS_WITH_TV, build
from deepir.burst import Burst
from deepir.config import Config
from deepir.estimation.residuals import temporal_mean
from deepir.fields.base import Field
from deepir.fields.constant import Constant
from deepir.fields.motion import Motion
from deepir.fields.sensor_maps import SumField
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.recipe import Recipe
from deepir.registry import components

#: Weights along an axis, binomial. Means of two leave waves too short for the half, which the scene can follow
#: in the first frame only, whose pixels are its own: all others then lie 0.3 px off, together.
BINOMIAL = (1, 7, 21, 35, 35, 21, 7, 1)
MIN_WEIGHT = 0.5  # of the samples that a pixel of the half is a mean of
EVERY_THIRD = slice(1, -1, 3)  # samples along an axis that are enough for a Gauss-Newton step
MIN_STEP = 0.2  # px by which a Gauss-Newton step moves the corners of a frame, if its motion is wrong
MIN_SIDE = 96  # px of the shorter side of a frame: the step of smaller ones says little


def coarse_to_fine(problem: Problem, recipe: Recipe, seed: int) -> None:
    """Start a problem; from the motion and the moving objects of half resolution if the start asks for another motion.

    By `recipe.start`. The effects of the half are those of the recipe; the seed is of the samples that are held out.
    """
    large = min(problem.data.shape[-2:]) >= MIN_SIDE and problem.saturation is None and not problem.agc
    untouched = {name: tensor.clone() for name, tensor in problem.state_dict().items()} if large else {}
    recipe.start(problem)
    if not large or gauss_newton_motion_step(problem) <= MIN_STEP:
        return
    problem.load_state_dict(untouched)
    half, rounds = half_resolution(problem), type(recipe)(recipe.effects)
    rounds.initialise(half, seed)
    stages = [stage for stage in rounds.plan(half) if stage.needed is None and not stage.use_held_out]
    solve(half, stages)
    upsample_motion(problem, half)
    upsample_moving_mask(problem, half)
    recipe.start(problem)


def half_resolution(problem: Problem) -> Problem:
    """The same burst on every second row and column, smoothed, before a sensor of columns, rows and pixels."""
    usable = (problem.precision > 0).to(problem.data)
    share = _smaller(usable)
    mean = _smaller(usable * problem.data) / share.clamp(min=1e-6)
    valid = (share >= MIN_WEIGHT)[:, 0].cpu().numpy()
    frames = np.where(valid, mean[:, 0].cpu().numpy(), 0)
    field, twice = motion_of(problem), _from_half(problem)
    motion = torch.linalg.solve(twice, field().detach().double().cpu() @ twice)
    physics = {
        "warp": {"motion": {"type": type(field).model, "init": "register"}},
        "sensor": _sensor(problem),
    }
    config = Config.model_validate({"problem": "nuc", "physics": physics, "scene": PIXELS_WITH_TV})
    half, _ = build(config, Burst(frames, valid, np.asarray(~valid.any(0))), motion)
    _take_known_maps(problem, half)
    return half.to(problem.data.device)


def _sensor(problem: Problem) -> dict[str, Any]:
    """The configuration of the half's sensor: the parts of gain, offset and level that are free."""
    kinds = {kind: name for name, kind in components("field").items()}
    found: dict[str, Any] = {}
    for slot, unknown in problem.sensor_unknowns().items():
        field = problem.fields[unknown]
        members = list(field.members.values()) if isinstance(field, SumField) else [field]
        names = [kinds[type(member)] for member in members]
        found[slot] = {"type": "+".join(names) if unknown in problem.free() else "constant"}
    return found


@torch.no_grad()
def _take_known_maps(problem: Problem, half: Problem) -> None:
    """Let the half's sensor have the maps that are known."""
    of_half = half.sensor_unknowns()
    for slot, unknown in problem.sensor_unknowns().items():
        value = problem.fields[unknown]()
        if isinstance(known := half.fields[of_half[slot]], Constant) and value.shape[-2:] == problem.data.shape[-2:]:
            known.values.copy_(_smaller(value))


@torch.no_grad()
def upsample_motion(problem: Problem, half: Problem) -> None:
    """Let a burst move as its half does."""
    twice = _from_half(problem)
    motion = twice @ motion_of(half)().double().cpu() @ torch.linalg.inv(twice)
    motion_of(problem).init_from(motion.to(problem.data.device))


@torch.no_grad()
def upsample_moving_mask(problem: Problem, half: Problem) -> None:
    """Let the samples of a burst show what moves by itself where those of its half do."""
    twice = half.moving.repeat_interleave(2, -2).repeat_interleave(2, -1)
    problem.moving.zero_()
    problem.moving[..., : twice.shape[-2], : twice.shape[-1]] = twice.to(problem.moving.device)


def _smaller(frames: Tensor) -> Tensor:
    """Frames (N, 1, h, w), zero beyond, between each two rows and columns: (N, 1, h // 2, w // 2)."""
    weights = torch.tensor(BINOMIAL).to(frames) / sum(BINOMIAL)
    h, w = (2 * (side // 2) for side in frames.shape[-2:])
    reach = len(BINOMIAL) // 2 - 1
    down = F.conv2d(frames[..., :h, :w], weights[:, None].expand(1, 1, -1, 1), stride=(2, 1), padding=(reach, 0))
    return F.conv2d(down, weights.expand(1, 1, 1, -1), stride=(1, 2), padding=(0, reach))


def _from_half(problem: Problem) -> Tensor:
    """Points of the half to those of the whole, (3, 3), each about its centre; an odd last line is left out."""
    h, w = (side % 2 / 2 for side in problem.data.shape[-2:])
    return torch.tensor([[2, 0, -w], [0, 2, -h], [0, 0, 1]], dtype=torch.float64)


def motion_of(problem: Problem) -> Field:
    """The field of how the camera moved, where its warp comes first."""
    return problem.field_of(f"{problem.operator.named()[0][0]}.motion")


@torch.no_grad()
def gauss_newton_motion_step(problem: Problem) -> float:
    """How far a frame asks to be moved at most: by shift and turn together, px at its corners.

    By one step of Gauss and Newton towards the frames less what stands still in them, from the scene as it is. Zero
    where there is more before the sensor than a camera that moves, and where its motion is fixed.
    """
    first, *others = (stage for _, stage in problem.operator.named())
    if not (first.moves and all(stage.pointwise for stage in others)):
        return 0.0
    motion = motion_of(problem)
    if not (isinstance(motion, Motion) and any(p.requires_grad for p in motion.parameters())):
        return 0.0
    values = problem.values()
    flux, rest = problem.flux(values), problem.data - problem.predict(values)
    rest -= temporal_mean(rest, problem.precision / problem.precision.amax())
    across, down = (
        (flux.roll(-1, axis) - flux.roll(1, axis))[1:, 0, EVERY_THIRD, EVERY_THIRD] / 2 for axis in (-1, -2)
    )
    h, w = flux.shape[-2:]
    y, x = (torch.arange(side, device=flux.device)[EVERY_THIRD] - (side - 1) / 2 for side in (h, w))
    turn = (down * x - across * y[:, None]) / (math.hypot(h, w) / 2)
    slopes = torch.stack((across, down, turn), 1).double().flatten(2)
    weight, apart = (each[1:, 0, EVERY_THIRD, EVERY_THIRD].double().flatten(1) for each in (problem.precision, rest))
    normal = torch.einsum("kis,ks,kjs->kij", slopes, weight, slopes)
    ridge = 1e-9 * normal.diagonal(dim1=1, dim2=2).mean().clamp(min=1e-30)  # a flat scene asks for nothing
    normal += ridge * torch.eye(3, device=flux.device)
    steps = torch.linalg.solve(normal, torch.einsum("kis,ks,ks->ki", slopes, weight, apart))
    return float(steps.abs().sum(1).max())
