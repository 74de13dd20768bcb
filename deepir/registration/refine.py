"""One robust Gauss-Newton step of each frame's motion."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.motion import generators
from deepir.registration.pyramid import Level

TUKEY = 4.0  # robust standard deviations beyond which a sample has no weight
DENSE = 40_000  # px: of larger levels every second pixel counts; what is band-passed is known from these


def step(seen: Tensor, expected: Tensor, known: Tensor, level: Level, model: str) -> Tensor:
    """Small motions `(B, P)` with `seen(p) = gain expected(inc p) + level`, as parameters of `generators`.

    seen, expected, known: `(B, h, w)`, on the grid of the first frame. Gain and level of each frame are solved
    along, under Tukey's weights.
    """
    h, w = seen.shape[1:]
    stride = 2 if h * w > DENSE else 1
    dy, dx = torch.gradient(expected, spacing=float(level.factor), dim=(1, 2))
    images = (dx, dy, expected, seen, inner(known))
    gx, gy, s, values, mask = (image[:, ::stride, ::stride].flatten(1) for image in images)
    ax, ay = generators(model, level.points(stride), max(level.shape) / 2)
    jacobian = torch.cat((gx[:, None] * ax + gy[:, None] * ay, s[:, None], torch.ones_like(s)[:, None]), 1)
    weight = tukey(values - s, mask)
    weighted = jacobian * weight[:, None]
    normal = (weighted @ jacobian.transpose(1, 2)).double()
    right = (weighted @ (values - s)[..., None]).double()
    ridge = 1e-6 * normal.diagonal(dim1=1, dim2=2).mean(1) + 1e-12
    normal = normal + ridge[:, None, None] * torch.eye(normal.shape[1], dtype=torch.float64)
    return torch.linalg.solve(normal, right)[:, : len(ax), 0].nan_to_num(0.0)


def inner(known: Tensor) -> Tensor:
    """Where `(B, h, w)` the four neighbours are known too, and with them the gradient."""
    out = known.clone()
    out[:, 1:] *= known[:, :-1]
    out[:, :-1] *= known[:, 1:]
    out[:, :, 1:] *= known[:, :, :-1]
    out[:, :, :-1] *= known[:, :, 1:]
    return out


def tukey(residual: Tensor, mask: Tensor) -> Tensor:
    """Tukey's biweight `(B, M)` of what a mask lets through."""
    residual = residual - (mask * residual).sum(1, keepdim=True) / mask.sum(1, keepdim=True).clamp_min(1)
    few = torch.where(mask > 0, residual.abs(), torch.nan)[:, ::7]
    spread = (1.4826 * few.nanmedian(1, keepdim=True).values).nan_to_num(1.0).clamp_min(1e-9)
    return mask * (1 - (residual / (TUKEY * spread)).square()).clamp_min(0) ** 2
