"""Scene, fixed pattern and motions of frames that show one scene, estimated alternately on one level."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import PARAMETERS, increment, relative
from deepir.registration.gauss_newton import gauss_newton_step
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import warp_to_reference

PATTERN_PASSES = 4  # alternations of scene and pattern at fixed motions
MIN_RELAXATION = 0.5  # Gauss-Newton steps; lower bound of the relaxation factor
MAX_RELAXATION = 3.0  # Gauss-Newton steps; upper bound of the relaxation factor
CONVERGED_STEP = 5e-3  # px of the level; a smaller step ends the rounds


@dataclass(frozen=True)
class Alignment:
    """What `align` finds, on a level.

    motion: `(N, 3, 3)` relative to the first frame. pattern: `(h, w)`. misfit: the share of the frames' mean square
    that neither scene nor pattern explain.
    """

    motion: Tensor
    pattern: Tensor
    misfit: float


def align(level: Level, motion: Tensor, model: str, max_rounds: int) -> Alignment:
    """Motions `(N, 3, 3)` refined against the mean of the *other* frames, the pattern taken out of all.

    Where more stands still than moves along, the pattern starts at the frames' mean: then little of the pattern
    is in the scene, but some of the scene in the pattern, and that takes some passes to come out.
    """
    n, size = len(motion), max(level.shape) / 2
    mean, pattern = level.frames.mean(0), torch.zeros_like(level.weight)
    motion, misfit = relative(motion), 1.0
    warped = warp_to_reference(level, pattern, motion)
    if n > 2 and mean.square().mean() > warped.mean.square().mean():
        pattern, misfit = estimate_pattern(level, motion)
        warped = warp_to_reference(level, pattern, motion)
    previous_step = torch.zeros(n, PARAMETERS[model], dtype=torch.float64)
    relaxation = torch.full((PARAMETERS[model],), 1 - 1 / n, dtype=torch.float64)
    for remaining in reversed(range(max_rounds)):
        step = gauss_newton_step(warped, level, model)
        relaxation = aitken_relaxation(relaxation, step, previous_step)
        previous_step = step
        motion = relative(increment(model, relaxation * step, size) @ motion)
        pattern, misfit = update_pattern(level, warped.mean, motion)
        if not remaining or float((relaxation * step).abs().max()) < CONVERGED_STEP * level.factor:
            break
        warped = warp_to_reference(level, pattern, motion)
    return Alignment(motion, pattern, misfit)


def estimate_pattern(level: Level, motion: Tensor) -> tuple[Tensor, float]:
    """The pattern `(h, w)` at these motions, from all that the frames have in common, and the misfit."""
    pattern = level.frames.mean(0)
    for _ in range(PATTERN_PASSES):
        pattern, misfit = update_pattern(level, warp_to_reference(level, pattern, motion).mean, motion)
    return pattern, misfit


def aitken_relaxation(relaxation: Tensor, step: Tensor, previous_step: Tensor) -> Tensor:
    """Lengths `(P,)` of the steps, from what became of the last ones: a step `before` left the step `delta` to do.

    Pattern and scene, which follow the motions, hold some parameters back; others would swing, as all frames move
    at once onto the mean of the others.
    """
    ratio = (step * previous_step).sum(0) / previous_step.square().sum(0).clamp_min(1e-12)
    return (relaxation / (1 - ratio).clamp_min(0.3)).clamp(MIN_RELAXATION, MAX_RELAXATION)


def update_pattern(level: Level, scene: Tensor, motion: Tensor) -> tuple[Tensor, float]:
    """What stands still `(h, w)` and is not the scene: lines, and pixels as far as they are clear; the misfit.

    A line is known from many pixels. The pixels' part, a mean over n frames, is shrunk by its share above the
    n-th part of the residual's variance (James & Stein 1961). Two frames with a free pattern for each pixel would
    fit any motion: they have lines only.
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    count, mean, residual = (torch.empty_like(level.weight) for _ in range(3))
    power = torch.empty(len(mean), dtype=torch.float64)
    shared = level.frames, level.weight, level.fully_known, scene, level.index_motion(motion)
    parallel_for(loops.differ, len(mean), *shared, count, mean, residual, power)
    lines = mean.mean(0, keepdim=True) + mean.mean(1, keepdim=True) - mean.mean()
    misfit = float(residual.double().sum() / power.sum().clamp_min(1e-12))
    if len(motion) < 3:
        return lines, misfit
    pixels = (mean - lines) * (count > 0)
    pattern_noise = residual / (count * (count - 1)).clamp_min(1)
    shrinkage = (1 - pattern_noise.mean() / pixels.square().mean().clamp_min(1e-12)).clamp(0, 1)
    return lines + shrinkage * pixels, misfit
