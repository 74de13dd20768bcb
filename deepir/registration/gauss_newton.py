"""One robust Gauss-Newton step of each frame's motion."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators.motion_models import generators
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import Pulled

TUKEY = 4.0  # robust standard deviations beyond which a sample has no weight
FEW = 3  # each so manieth sample along an axis is enough for a standard deviation
DENSE = 40_000  # px: of larger levels every second pixel counts; what is band-passed is known from these


def step(pulled: Pulled, level: Level, model: str) -> Tensor:
    """Small motions `(N, P)` with `frame(p) = gain others(inc p) + level`, as parameters of `generators`.

    Gain and level of each frame are solved along, under Tukey's weights.
    """
    return solved(sums(pulled, level, model))


def sums(pulled: Pulled, level: Level, model: str) -> Tensor:
    """What `step` solves, `(rows, N, P + 2, P + 3)`: of each row, the normal equations and their right side."""
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    stride = 2 if level.weight.numel() > DENSE else 1
    ax, ay = generators(model, level.points(stride), max(level.shape) / 2)
    few = pulled.thinned(stride * FEW)
    expected, known = few.others()
    middle, limit = spread_of((few.frames - expected).flatten(1), known.flatten(1))
    n, (p, rows, _) = len(few.frames), ax.shape
    found = torch.empty(rows, n, p + 2, p + 3)
    images = pulled.frames, pulled.known, pulled.total, pulled.count
    parallel_for(
        loops.gauss_newton_sums, rows, *images, ax, ay, stride, float(level.factor), middle, limit, found
    )
    return found


def solved(rows: Tensor) -> Tensor:
    """Motions `(N, P)` from the sums of some rows."""
    p = rows.shape[2] - 2
    normal, right = rows.double().sum(0).split((p + 2, 1), 2)
    ridge = 1e-6 * normal.diagonal(dim1=1, dim2=2).mean(1) + 1e-12
    normal = normal + ridge[:, None, None] * torch.eye(p + 2, dtype=torch.float64)
    return torch.linalg.solve(normal, right)[:, :p, 0].nan_to_num(0.0)


def tukey(residual: Tensor, mask: Tensor) -> Tensor:
    """Tukey's biweight `(N, M)` of what a mask lets through."""
    middle, limit = spread_of(residual, mask)
    return mask * (1 - ((residual - middle[:, None]) / limit[:, None]).square()).clamp_min(0) ** 2


def spread_of(residual: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
    """Mean `(N)` of what a mask lets through of `(N, M)`, and from where on a sample has no weight."""
    middle = (mask * residual).sum(1) / mask.sum(1).clamp_min(1)
    apart = torch.where(mask > 0, (residual - middle[:, None]).abs(), torch.nan).nanmedian(1).values
    return middle, TUKEY * (1.4826 * apart).nan_to_num(1.0).clamp_min(1e-9)
