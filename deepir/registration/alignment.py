"""Scene, fixed pattern and motions of frames that show one scene, estimated alternately on one level.

Frames on the grid of the first.

One robust Gauss-Newton step of each frame's motion."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import PARAMETERS, generators, increment, relative
from deepir.registration.pyramid import Level, sample

PATTERN_PASSES = 4  # alternations of scene and pattern at fixed motions
MIN_RELAXATION = 0.5  # Gauss-Newton steps; lower bound of the relaxation factor
MAX_RELAXATION = 3.0  # Gauss-Newton steps; upper bound of the relaxation factor
CONVERGED_STEP = 5e-3  # px of the level; a smaller step ends the rounds

TUKEY_CUTOFF = 4.0  # robust standard deviations; residuals beyond have no weight
SIGMA_STRIDE = 3  # the robust standard deviation is that of every third sample along each axis
MAX_DENSE_PIXELS = 40_000  # px; larger levels, which are band-passed, use every second pixel along each axis


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


@dataclass(frozen=True)
class WarpedFrames:
    """Frames `(N, h, w)` on the grid of the first, where they are known, and over the frames the sums of both."""

    frames: Tensor
    known: Tensor
    total: Tensor
    count: Tensor

    @property
    def mean(self) -> Tensor:
        """The scene `(h, w)`."""
        return self.total / self.count.clamp_min(1)

    def leave_one_out_mean(self) -> tuple[Tensor, Tensor]:
        """For each frame the mean of all others, and where both are known."""
        count = self.count - self.known
        return (self.total - self.frames) / count.clamp_min(1), self.known * (count > 0.5)

    def subsampled(self, stride: int) -> WarpedFrames:
        """Every `stride`-th pixel along each axis."""
        strided = slice(None, None, stride)
        images = (self.frames, self.known, self.total, self.count)
        return WarpedFrames(*(each[..., strided, strided] for each in images))


def warp_to_reference(level: Level, pattern: Tensor, motion: Tensor) -> WarpedFrames:
    """Frames less the pattern, pulled back."""
    frames, known = sample(level.frames - pattern, torch.linalg.inv(motion), level)
    return WarpedFrames(frames, known, frames.sum(0), known.sum(0))


def gauss_newton_step(warped: WarpedFrames, level: Level, model: str) -> Tensor:
    """Small motions `(N, P)` with `frame(p) = gain others(inc p) + level`, as parameters of `generators`.

    Gain and level of each frame are solved along, under Tukey's weights.
    """
    return solve_normal_equations(normal_equations(warped, level, model))


def normal_equations(warped: WarpedFrames, level: Level, model: str) -> Tensor:
    """What `step` solves, `(rows, N, P + 2, P + 3)`: of each row, the normal equations and their right side."""
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    stride = 2 if level.weight.numel() > MAX_DENSE_PIXELS else 1
    ax, ay = generators(model, level.grid_points(stride), max(level.shape) / 2)
    sparse = warped.subsampled(stride * SIGMA_STRIDE)
    expected, known = sparse.leave_one_out_mean()
    centre, cutoff = centre_and_cutoff((sparse.frames - expected).flatten(1), known.flatten(1))
    n, (p, rows, _) = len(sparse.frames), ax.shape
    equations = torch.empty(rows, n, p + 2, p + 3)
    images = warped.frames, warped.known, warped.total, warped.count
    parallel_for(loops.step, rows, *images, ax, ay, stride, float(level.factor), centre, cutoff, equations)
    return equations


def solve_normal_equations(equations: Tensor) -> Tensor:
    """Motions `(N, P)` from the sums of some rows."""
    p = equations.shape[2] - 2
    normal, right_side = equations.double().sum(0).split((p + 2, 1), 2)
    ridge = 1e-6 * normal.diagonal(dim1=1, dim2=2).mean(1) + 1e-12
    normal = normal + ridge[:, None, None] * torch.eye(p + 2, dtype=torch.float64)
    return torch.linalg.solve(normal, right_side)[:, :p, 0].nan_to_num(0.0)


def tukey_weights(residual: Tensor, mask: Tensor) -> Tensor:
    """Tukey's biweight `(N, M)` of what a mask lets through."""
    centre, cutoff = centre_and_cutoff(residual, mask)
    return mask * (1 - ((residual - centre[:, None]) / cutoff[:, None]).square()).clamp_min(0) ** 2


def centre_and_cutoff(residual: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Mean `(N)` of what a mask lets through of `(N, M)`, and from where on a sample has no weight."""
    centre = (mask * residual).sum(1) / mask.sum(1).clamp_min(1)
    deviation = torch.where(mask > 0, (residual - centre[:, None]).abs(), torch.nan).nanmedian(1).values
    return centre, TUKEY_CUTOFF * (1.4826 * deviation).nan_to_num(1.0).clamp_min(1e-9)
