"""Scene, fixed pattern and motions of frames that show one scene, estimated alternately on one level."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.registration.motion import PARAMETERS, increment, relative
from deepir.registration.pyramid import Level, sample
from deepir.registration.refine import step

BATCH = 400_000  # px worked on at a time: temporaries stay small, and in the cache
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
    picture = pull(level, pattern, motion).mean
    if n > 2 and mean.square().mean() > picture.square().mean():
        pattern, misfit = standing(level, motion)
    before = torch.zeros(n, PARAMETERS[model], dtype=torch.float64)
    length = torch.full((PARAMETERS[model],), 1 - 1 / n, dtype=torch.float64)
    for _ in range(rounds):
        seen, delta = pull(level, pattern, motion), torch.zeros_like(before)
        for k in batches(level, n):
            delta[k] = step(seen.frames[k], *seen.others(k), level, model)
        length = secant(length, delta, before)
        before = delta
        motion = relative(increment(model, length * delta, size) @ motion)
        pattern, misfit = fixed_pattern(level, seen.mean, motion)
        if float((length * delta).abs().max()) < SETTLED * level.factor:
            break
    return Aligned(motion, pattern, misfit)


def standing(level: Level, motion: Tensor) -> tuple[Tensor, float]:
    """The pattern `(h, w)` at these motions, from all that the frames have in common, and the misfit."""
    pattern = level.frames.mean(0)
    for _ in range(AHEAD):
        pattern, misfit = fixed_pattern(level, pull(level, pattern, motion).mean, motion)
    return pattern, misfit


def secant(length: Tensor, delta: Tensor, before: Tensor) -> Tensor:
    """Lengths `(P,)` of the steps, from what became of the last ones: a step `before` left the step `delta` to do.

    Pattern and scene, which follow the motions, hold some parameters back; others would swing, as all frames move
    at once onto the mean of the others.
    """
    left = (delta * before).sum(0) / before.square().sum(0).clamp_min(1e-12)
    return (length / (1 - left).clamp_min(0.3)).clamp(SHORTEST, LONGEST)


@dataclass(frozen=True)
class Pulled:
    """Frames `(N, h, w)` on the grid of the first, and where they are known."""

    frames: Tensor
    known: Tensor
    total: Tensor
    count: Tensor

    @property
    def mean(self) -> Tensor:
        """The scene `(h, w)`."""
        return self.total / self.count.clamp_min(1)

    def others(self, k: slice) -> tuple[Tensor, Tensor]:
        """For frames `k` the mean of all others, and where both are known."""
        count = self.count - self.known[k]
        return (self.total - self.frames[k]) / count.clamp_min(1), self.known[k] * (count > 0.5)


def pull(level: Level, pattern: Tensor, motion: Tensor) -> Pulled:
    """Frames less the pattern, pulled back."""
    back = torch.linalg.inv(motion)
    frames, known = torch.empty_like(level.frames), torch.empty_like(level.frames)
    for k in batches(level, len(motion)):
        frames[k], known[k] = sample(level.frames[k] - pattern, back[k], level)
    return Pulled(frames, known, frames.sum(0), known.sum(0))


def batches(level: Level, n: int) -> list[slice]:
    """Slices of `n` frames, few enough at a time."""
    size = max(1, BATCH // level.weight.numel())
    return [slice(k, min(k + size, n)) for k in range(0, n, size)]


def fixed_pattern(level: Level, picture: Tensor, motion: Tensor) -> tuple[Tensor, float]:
    """What stands still `(h, w)` and is not the scene: lines, and pixels as far as they are clear; the misfit.

    A line is known from many pixels. The pixels' part, a mean over n frames, is shrunk by its share above the
    n-th part of the residual's variance (James & Stein 1961). Two frames with a free pattern for each pixel would
    fit any motion: they have lines only.
    """
    count, total, square, power = (torch.zeros_like(level.weight) for _ in range(4))
    for k in batches(level, len(motion)):
        expected, seen = sample(picture, motion[k], level)
        residual = seen * level.frames[k] - expected
        count += seen.sum(0)
        total += residual.sum(0)
        square += residual.square().sum(0)
        power += (seen * level.frames[k]).square().sum(0)
    n = count.clamp_min(1)
    mean = total / n
    rest = square - n * mean**2
    lines = mean.mean(0, keepdim=True) + mean.mean(1, keepdim=True) - mean.mean()
    misfit = float(rest.sum() / power.sum().clamp_min(1e-12))
    if len(motion) < 3:
        return lines, misfit
    pixels = (mean - lines) * (count > 0)
    chance = rest / (n * (n - 1).clamp_min(1))
    keep = (1 - chance.mean() / pixels.square().mean().clamp_min(1e-12)).clamp(0, 1)
    return lines + keep * pixels, misfit
