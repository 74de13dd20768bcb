"""What a scene gains from noise alone: more where the camera moves by whole pixels than by halves.

A frame that lies half way between the pixels of the scene hardly shows its shortest waves, so that the noise in these
stays unexplained. The joint optimum of scene and motion therefore lies nearer to whole pixels than the truth does. From
noise alone a wave gains half a nat times the share in it that the data decide, and not the prior: its degrees of
freedom (Hastie, Tibshirani 1990, "Generalized additive models"). With these given back, noise draws the motion nowhere.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from deepir.operators import Lag
from deepir.priors.motion import Motion
from deepir.problem import Problem
from deepir.waves import modelled

#: Under the weak prior, what holds the scene's gradients, as a share of what the frames hold its pixels by.
HELD = 0.001
WAVES, PLACES = 24, 5  # along each axis, of the spectrum and of the frame


def moves_with_scene(problem: Problem, group: Collection[str]) -> bool:
    """Whether the scene is free together with a motion of few parameters, and all of a frame is seen at once."""
    if not modelled(problem) or any(isinstance(stage, Lag) for _, stage in problem.operator.named()):
        return False
    motion = problem.slots["warp.motion"]
    return {"scene", motion} <= set(group) and isinstance(problem.fields[motion], Motion)


def freedom(motion: Tensor, size: Sequence[int]) -> Tensor:
    """Nats that a scene gains from the noise of frames of `size` (h, w) at motions (N, 3, 3)."""
    motion = motion.double()
    waves = (torch.arange(WAVES).to(motion) + 0.5) * (math.pi / WAVES)
    y, x = (side * torch.linspace(-0.4, 0.4, PLACES).to(motion) for side in size)
    places = torch.cartesian_prod(x, y, x.new_ones(1)).T
    moved = motion @ places
    shift = (moved[:, :2] / moved[:, 2:] - places[:2]).permute(2, 1, 0)  # (places, x or y, N)
    along_x, along_y = response(shift, waves).unbind(1)
    seen = along_y.mT @ along_x / len(motion)
    held = HELD * (4 - 2 * waves.cos() - 2 * waves.cos()[:, None])
    return 0.5 * math.prod(size) * (seen / (seen + held)).mean()


def response(shift: Tensor, waves: Tensor) -> Tensor:
    """Squared response of a cubic B-spline, sampled at shifts (...), to waves (K,) of its coefficients: (..., K)."""
    t = shift - shift.floor()
    taps = torch.stack(((1 - t) ** 3, 4 - 6 * t**2 + 3 * t**3, 1 + 3 * t + 3 * t**2 - 3 * t**3, t**3), -1) / 6
    each = [(2 if apart else 1) * (taps[..., apart:] * taps[..., : 4 - apart]).sum(-1) for apart in range(4)]
    return torch.stack(each, -1) @ (torch.arange(4).to(waves)[:, None] * waves).cos()
