"""The same burst at half its size, which tells how the camera moved where the whole one has it wrong."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.build.problem import build
from deepir.burst import Burst
from deepir.config import load
from deepir.problem import Problem
from deepir.problems.motion_step import motion_of

#: Weights along an axis, binomial. Means of two leave waves too short for the half, which the scene can follow
#: in the first frame only, whose pixels are its own: all others then lie 0.3 px off, together.
SMOOTH = (1, 7, 21, 35, 35, 21, 7, 1)
KNOWN = 0.5  # of a sample's weight, to count


def half_resolution(problem: Problem) -> Problem:
    """The same burst on every second row and column, smoothed, before a sensor of columns, rows and pixels."""
    usable = (problem.precision > 0).to(problem.data)
    share = _smaller(usable)
    mean = _smaller(usable * problem.data) / share.clamp(min=1e-6)
    valid = (share >= KNOWN)[:, 0].cpu().numpy()
    frames = np.where(valid, mean[:, 0].cpu().numpy(), 0)
    field, twice = motion_of(problem), _from_half(problem)
    motion = torch.linalg.solve(twice, field().detach().double().cpu() @ twice)
    config = load("nuc", [f"physics.warp.motion.type={type(field).model}", "prior=tv"])
    half, _ = build(config, Burst(frames, valid, np.asarray(~valid.any(0))), motion)
    return half.to(problem.data.device)


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
    weights = torch.tensor(SMOOTH).to(frames) / sum(SMOOTH)
    h, w = (2 * (side // 2) for side in frames.shape[-2:])
    reach = len(SMOOTH) // 2 - 1
    down = F.conv2d(
        frames[..., :h, :w], weights[:, None].expand(1, 1, -1, 1), stride=(2, 1), padding=(reach, 0)
    )
    return F.conv2d(down, weights.expand(1, 1, 1, -1), stride=(1, 2), padding=(0, reach))


def _from_half(problem: Problem) -> Tensor:
    """Points of the half to those of the whole, (3, 3), each about its centre; an odd last line is left out."""
    h, w = (side % 2 / 2 for side in problem.data.shape[-2:])
    return torch.tensor([[2, 0, -w], [0, 2, -h], [0, 0, 1]], dtype=torch.float64)
