"""Robust Gauss-Newton refinement of motions, on one level of the pyramid."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.motion import generators, increment, normalised, transform
from deepir.registration.pyramid import Level, sample

TUKEY = 4.0  # robust standard deviations beyond which a sample has no weight
SETTLED = 2e-3  # px of the level: a smaller step ends the iteration
OVERLAP = 0.15  # the least share of the frame that must see the reference


def refine(
    frames: Tensor, references: Tensor, seen: Tensor, level: Level, motion: Tensor, model: str, steps: int
) -> tuple[Tensor, Tensor]:
    """Motions `(B, 3, 3)` such that `frames[b](p) = gain_b references[b](T_b p) + level_b`, and correlations
    `(B,)`.

    frames: `(B, h, w)`; references, seen: `(B, h, w)`, the reference images and where they are known. Forward
    compositional Gauss-Newton (Baker & Matthews 2004) with Tukey weights; gain and level of each frame are
    solved along.
    """
    h, w = frames.shape[1:]
    stride = 2 if h * w > 100_000 else 1  # the frames are band-passed: every second pixel says it all
    keep = torch.arange(h * w).reshape(h, w)[stride // 2 :: stride, stride // 2 :: stride].flatten()
    points = level.points()[:, keep]
    values = frames.flatten(1)[:, keep]
    weight = level.weight.flatten()[keep]
    stack = torch.stack((references, *gradient(references, level.factor), seen), 1)
    size = max(level.shape) / 2
    for _ in range(steps):
        moved = transform(motion, points)
        s, gx, gy, known = sample(stack, moved, level).unbind(1)
        dx, dy = generators(model, moved, size)
        jacobian = torch.cat(
            (gx[:, None] * dx + gy[:, None] * dy, s[:, None], torch.ones_like(s)[:, None]), 1
        )
        delta = robust_step(jacobian, values, s, weight * (known > 0.95))[:, : dx.shape[1]]
        motion = normalised(increment(model, delta, size) @ motion)
        if float(delta.abs().max()) < SETTLED * level.factor:
            break
    s, _, _, known = sample(stack, transform(motion, points), level).unbind(1)
    return motion, weighted_correlation(values, s, weight * (known > 0.95))


def gradient(images: Tensor, factor: int) -> tuple[Tensor, Tensor]:
    """Central differences of `(B, h, w)` along x and y, per full-frame px."""
    dy, dx = torch.gradient(images, spacing=float(factor), dim=(1, 2))
    return dx, dy


def robust_step(jacobian: Tensor, values: Tensor, s: Tensor, mask: Tensor) -> Tensor:
    """The step `(B, P + 2)` of `values = s + jacobian delta` under Tukey's biweight; zero where singular."""
    residual = values - s
    count = mask.sum(1, keepdim=True).clamp_min(1)
    residual = residual - (mask * residual).sum(1, keepdim=True) / count
    spread = (
        1.4826 * torch.where(mask > 0, residual.abs(), torch.nan)[:, ::7].nanmedian(1, keepdim=True).values
    )
    u = residual / (TUKEY * spread.nan_to_num(1.0)).clamp_min(1e-9)
    weight = mask * (1 - u * u).clamp_min(0) ** 2
    weighted = jacobian * weight[:, None]
    normal = (weighted @ jacobian.transpose(1, 2)).double()
    right = (weighted @ (values - s)[..., None]).double()
    ridge = 1e-6 * normal.diagonal(dim1=1, dim2=2).mean(1) + 1e-12
    normal = normal + ridge[:, None, None] * torch.eye(normal.shape[1], dtype=torch.float64)
    return torch.linalg.solve(normal, right)[..., 0].nan_to_num(0.0)


def weighted_correlation(a: Tensor, b: Tensor, weight: Tensor) -> Tensor:
    """Correlation `(B,)` of `(B, M)` samples; zero where the overlap is too small or there is no texture."""
    total = weight.sum(1, keepdim=True)
    a = a - (weight * a).sum(1, keepdim=True) / total.clamp_min(1)
    b = b - (weight * b).sum(1, keepdim=True) / total.clamp_min(1)
    power = (weight * a * a).sum(1) * (weight * b * b).sum(1)
    score = (weight * a * b).sum(1) / power.sqrt().clamp_min(1e-9)
    return torch.where(total[:, 0] > OVERLAP * a.shape[1], score, 0.0).double()
