"""One robust Gauss-Newton step of each frame's motion."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators.motion_models import generators
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import WarpedFrames

TUKEY_CUTOFF = 4.0  # robust standard deviations; residuals beyond have no weight
SIGMA_STRIDE = 3  # the robust standard deviation is that of every third sample along each axis
MAX_DENSE_PIXELS = 40_000  # px; larger levels, which are band-passed, use every second pixel along each axis


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
