"""Alternating estimation of scene, fixed pattern and motions of frames that show one scene, on one level.

Each round of `align` has three parts: the frames, less the pattern, are warped onto the grid of the first
(`warp_to_reference`); each frame takes a robust Gauss-Newton step towards the mean of the others
(`normal_equations`), of a relaxed length (`aitken_relaxation`); the pattern is estimated anew (`update_pattern`).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.operators.motion_models import PARAMETERS, generators, increment, relative
from deepir.registration.preprocess import Level, sample

PATTERN_PASSES = 4  # alternations of scene and pattern at fixed motions
CONVERGED_STEP = 5e-3  # px of the level; a smaller step ends the rounds
TUKEY_CUTOFF = 4.0  # robust standard deviations; residuals beyond have no weight
SIGMA_STRIDE = 3  # the robust standard deviation is that of every third sample along each axis
MAX_DENSE_PIXELS = 40_000  # px; of larger levels every second pixel along each axis is used


@dataclass(frozen=True)
class Alignment:
    """Result of `align`.

    motion: `(N, 3, 3)`, relative to the first frame. pattern: `(h, w)`. misfit: fraction of the frames' mean square
    that scene and pattern do not explain.
    """

    motion: Tensor
    pattern: Tensor
    misfit: float


@dataclass(frozen=True)
class WarpedFrames:
    """Frames on the grid of the first.

    frames: `(N, h, w)`, zero where unknown. known: `(N, h, w)`, one or zero. total, count: `(h, w)`, the sums of both
    over the frames.
    """

    frames: Tensor
    known: Tensor
    total: Tensor
    count: Tensor

    @property
    def mean(self) -> Tensor:
        """Mean of the known samples: the scene `(h, w)`."""
        return self.total / self.count.clamp_min(1)

    def leave_one_out_mean(self) -> tuple[Tensor, Tensor]:
        """For each frame the mean `(N, h, w)` of all others, and where it and the frame are known `(N, h, w)`."""
        count = self.count - self.known
        return (self.total - self.frames) / count.clamp_min(1), self.known * (count > 0.5)


def align(level: Level, motion: Tensor, model: str, max_rounds: int) -> Alignment:
    """Refine motions by robust Gauss-Newton steps towards the leave-one-out mean, the pattern subtracted.

    If the mean of the frames has more power than that of the warped frames, the pattern dominates. Then it starts at
    the mean of the frames, and scene is separated from it in some passes. `motion` holds the initial motions
    `(N, 3, 3)`, `model` is a key of `PARAMETERS`.
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
        step = solve_normal_equations(normal_equations(warped, level, model))
        relaxation = aitken_relaxation(relaxation, step, previous_step)
        previous_step = step
        motion = relative(increment(model, relaxation * step, size) @ motion)
        pattern, misfit = update_pattern(level, warped.mean, motion)
        if not remaining or float((relaxation * step).abs().max()) < CONVERGED_STEP * level.factor:
            break
        warped = warp_to_reference(level, pattern, motion)
    return Alignment(motion, pattern, misfit)


def warp_to_reference(level: Level, pattern: Tensor, motion: Tensor) -> WarpedFrames:
    """Frames less the pattern `(h, w)`, warped onto the grid of the first by the inverse of motions `(N, 3, 3)`."""
    frames, known = sample(level.frames - pattern, torch.linalg.inv(motion), level)
    return WarpedFrames(frames, known, frames.sum(0), known.sum(0))


def aitken_relaxation(relaxation: Tensor, step: Tensor, previous_step: Tensor) -> Tensor:
    """New relaxation factors `(P,)` of the parameters by Aitken's delta-squared (secant) rule, common to all frames.

    Scene and pattern follow the motions and slow some parameters down. Others would oscillate, since all frames step
    towards the mean of the others at once. `step` is the Gauss-Newton step `(N, P)`; the one before is zero in the
    first round.
    """
    ratio = (step * previous_step).sum(0) / previous_step.square().sum(0).clamp_min(1e-12)
    return (relaxation / (1 - ratio).clamp_min(0.3)).clamp(0.5, 3.0)  # bounds of the denominator and of the factors


def estimate_pattern(level: Level, motion: Tensor) -> tuple[Tensor, float]:
    """Pattern `(h, w)` and misfit at fixed motions `(N, 3, 3)`, alternating with the scene from the frames' mean."""
    pattern = level.frames.mean(0)
    for _ in range(PATTERN_PASSES):
        pattern, misfit = update_pattern(level, warp_to_reference(level, pattern, motion).mean, motion)
    return pattern, misfit


def accept_by_misfit(level: Level, motion: Tensor, reference: Tensor, max_ratio: float = 1.0) -> bool:
    """Decide for motions `(N, 3, 3)` if their misfit is less than `max_ratio` times that of reference motions."""
    return estimate_pattern(level, motion)[1] < max_ratio * estimate_pattern(level, reference)[1]


def update_pattern(level: Level, scene: Tensor, motion: Tensor) -> tuple[Tensor, float]:
    """Fixed pattern `(h, w)` of frames whose scene `(h, w)` and motions `(N, 3, 3)` are given, and the misfit.

    The pattern is row and column offsets plus shrunk pixel offsets. The offset of a line is a mean of many pixels. That
    of a pixel is a mean over few frames: it is shrunk by the fraction of its variance that exceeds the one expected
    from the residual. Two frames have line offsets only, since with pixel offsets they would fit any motion.

    Source: James and Stein, Estimation with quadratic loss, 4th Berkeley Symposium (1961).
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    count, mean, residual = (torch.empty_like(level.weight) for _ in range(3))
    power = torch.empty(len(mean), dtype=torch.float64)
    shared = level.frames, level.weight, level.fully_known, scene, level.index_motion(motion)
    parallel_for(loops.residual_moments, len(mean), *shared, count, mean, residual, power)
    lines = mean.mean(0, keepdim=True) + mean.mean(1, keepdim=True) - mean.mean()
    misfit = float(residual.double().sum() / power.sum().clamp_min(1e-12))
    if len(motion) < 3:
        return lines, misfit
    pixels = (mean - lines) * (count > 0)
    pattern_noise = residual / (count * (count - 1)).clamp_min(1)
    shrinkage = (1 - pattern_noise.mean() / pixels.square().mean().clamp_min(1e-12)).clamp(0, 1)
    return lines + shrinkage * pixels, misfit


def normal_equations(warped: WarpedFrames, level: Level, model: str) -> Tensor:
    """Normal equations, row by row, of a robust Gauss-Newton step of each frame's motion to the leave-one-out mean.

    Gain and level of each frame are unknown as well: `frame(p) = gain * mean(increment(p)) + level`. The equations are
    `(rows, N, P + 2, P + 3)`: the matrix of the motion's parameters, gain and level, and the right side in the last
    column. `model` is a key of `PARAMETERS`.
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    stride = 2 if level.weight.numel() > MAX_DENSE_PIXELS else 1
    ax, ay = generators(model, level.grid_points(stride), max(level.shape) / 2)
    images = warped.frames, warped.known, warped.total, warped.count
    strided = slice(None, None, stride * SIGMA_STRIDE)
    sparse = WarpedFrames(*(each[..., strided, strided] for each in images))
    expected, known = sparse.leave_one_out_mean()
    centre, cutoff = centre_and_cutoff((sparse.frames - expected).flatten(1), known.flatten(1))
    n, (p, rows, _) = len(sparse.frames), ax.shape
    equations = torch.empty(rows, n, p + 2, p + 3)
    parallel_for(loops.gauss_newton_sums, rows, *images, ax, ay, stride, float(level.factor), centre, cutoff, equations)
    return equations


def solve_normal_equations(equations: Tensor) -> Tensor:
    """Parameters `(N, P)` of `increment`, px at the frame's edge, from normal equations `(rows, N, P + 2, P + 3)`.

    These are summed over rows, with a small ridge.
    """
    p = equations.shape[2] - 2
    normal, right_side = equations.double().sum(0).split((p + 2, 1), 2)
    ridge = 1e-6 * normal.diagonal(dim1=1, dim2=2).mean(1) + 1e-12
    normal = normal + ridge[:, None, None] * torch.eye(p + 2, dtype=torch.float64)
    return torch.linalg.solve(normal, right_side)[:, :p, 0].nan_to_num(0.0)


def tukey_weights(residual: Tensor, mask: Tensor) -> Tensor:
    """Tukey's biweight `(N, M)` of residuals `(N, M)`; zero where the mask `(N, M)` is."""
    centre, cutoff = centre_and_cutoff(residual, mask)
    return mask * (1 - ((residual - centre[:, None]) / cutoff[:, None]).square()).clamp_min(0) ** 2


def centre_and_cutoff(residual: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Mean `(N,)` of the masked residuals `(N, M)`, and the deviation from it `(N,)` at which weights are zero."""
    centre = (mask * residual).sum(1) / mask.sum(1).clamp_min(1)
    deviation = torch.where(mask > 0, (residual - centre[:, None]).abs(), torch.nan).nanmedian(1).values
    return centre, TUKEY_CUTOFF * (MAD_TO_SIGMA * deviation).nan_to_num(1.0).clamp_min(1e-9)
