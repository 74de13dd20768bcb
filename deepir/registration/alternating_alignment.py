"""Scene, fixed pattern and motions of frames that show one scene, estimated alternately on one level."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import PARAMETERS, increment, relative
from deepir.registration.gauss_newton import step
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import pull

AHEAD = 4  # passes over scene and pattern before the motions, where the pattern is the stronger
SHORTEST, LONGEST = 0.5, 3.0  # times a Gauss-Newton step
SETTLED = 5e-3  # px of the level: a smaller step ends the rounds


@dataclass(frozen=True)
class Aligned:
    """What `align` finds, on a level.

    motion: `(N, 3, 3)` relative to the first frame. pattern: `(h, w)`. misfit: the share of the frames' mean square
    that neither scene nor pattern explain.
    """

    motion: Tensor
    pattern: Tensor
    misfit: float


def align(level: Level, motion: Tensor, model: str, rounds: int) -> Aligned:
    """Motions `(N, 3, 3)` refined against the mean of the *other* frames, the pattern taken out of all.

    Where more stands still than moves along, the pattern starts at the frames' mean: then little of the pattern
    is in the scene, but some of the scene in the pattern, and that takes some passes to come out.
    """
    n, size = len(motion), max(level.shape) / 2
    mean, pattern = level.frames.mean(0), torch.zeros_like(level.weight)
    motion, misfit = relative(motion), 1.0
    seen = pull(level, pattern, motion)
    if n > 2 and mean.square().mean() > seen.mean.square().mean():
        pattern, misfit = standing(level, motion)
        seen = pull(level, pattern, motion)
    before = torch.zeros(n, PARAMETERS[model], dtype=torch.float64)
    length = torch.full((PARAMETERS[model],), 1 - 1 / n, dtype=torch.float64)
    for remaining in reversed(range(rounds)):
        delta = step(seen, level, model)
        length = aitken_step(length, delta, before)
        before = delta
        motion = relative(increment(model, length * delta, size) @ motion)
        pattern, misfit = fixed_pattern(level, seen.mean, motion)
        if not remaining or float((length * delta).abs().max()) < SETTLED * level.factor:
            break
        seen = pull(level, pattern, motion)
    return Aligned(motion, pattern, misfit)


def standing(level: Level, motion: Tensor) -> tuple[Tensor, float]:
    """The pattern `(h, w)` at these motions, from all that the frames have in common, and the misfit."""
    pattern = level.frames.mean(0)
    for _ in range(AHEAD):
        pattern, misfit = fixed_pattern(level, pull(level, pattern, motion).mean, motion)
    return pattern, misfit


def aitken_step(length: Tensor, delta: Tensor, before: Tensor) -> Tensor:
    """Lengths `(P,)` of the steps, from what became of the last ones: a step `before` left the step `delta` to do.

    Pattern and scene, which follow the motions, hold some parameters back; others would swing, as all frames move
    at once onto the mean of the others.
    """
    left = (delta * before).sum(0) / before.square().sum(0).clamp_min(1e-12)
    return (length / (1 - left).clamp_min(0.3)).clamp(SHORTEST, LONGEST)


def fixed_pattern(level: Level, picture: Tensor, motion: Tensor) -> tuple[Tensor, float]:
    """What stands still `(h, w)` and is not the scene: lines, and pixels as far as they are clear; the misfit.

    A line is known from many pixels. The pixels' part, a mean over n frames, is shrunk by its share above the
    n-th part of the residual's variance (James & Stein 1961). Two frames with a free pattern for each pixel would
    fit any motion: they have lines only.
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    count, mean, rest = (torch.empty_like(level.weight) for _ in range(3))
    power = torch.empty(len(mean), dtype=torch.float64)
    given = level.frames, level.weight, level.whole, picture, level.indexed(motion)
    parallel_for(loops.residual_moments, len(mean), *given, count, mean, rest, power)
    lines = mean.mean(0, keepdim=True) + mean.mean(1, keepdim=True) - mean.mean()
    misfit = float(rest.double().sum() / power.sum().clamp_min(1e-12))
    if len(motion) < 3:
        return lines, misfit
    pixels = (mean - lines) * (count > 0)
    chance = rest / (count * (count - 1)).clamp_min(1)
    keep = (1 - chance.mean() / pixels.square().mean().clamp_min(1e-12)).clamp(0, 1)
    return lines + keep * pixels, misfit
