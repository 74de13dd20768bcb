"""Displacements of motions, given as homographies (N, 3, 3) or as sampling points (N, h, w, 2)."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators.warp import project_pixels


def displacement_at(motion: Tensor, at: Tensor) -> Tensor:
    """Displacement (x, y) of the point `at` (2,) in each frame, (N, 2) px; of the nearest pixel for sampling points."""
    if motion.ndim == 3:
        moved = motion @ torch.cat((at, at.new_ones(1)))
        return moved[:, :2] / moved[:, 2:] - at
    column, row = (round(float(c) + (side - 1) / 2) for c, side in zip(at, motion.shape[2:0:-1], strict=True))
    return displacements(motion)[:, :, row, column]


def displacements(points: Tensor) -> Tensor:
    """Displacements (x, y) of all pixels, px: (N, h, w, 2) -> (N, 2, h, w)."""
    still = project_pixels(torch.eye(3).to(points)[None], (points.shape[1], points.shape[2]))
    return (points - still).permute(0, 3, 1, 2)


def homographies(motion: Tensor) -> Tensor:
    """Homographies (N, 3, 3): the motion itself, or a depth-weighted least-squares fit to sampling points."""
    if motion.ndim == 3:
        return motion
    size = (motion.shape[1], motion.shape[2])
    x, y = project_pixels(torch.eye(3).to(motion).double()[None], size)[0].flatten(0, 1).T
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    found = []
    for u, v in motion.double().flatten(1, 2).mT:
        of_u = torch.stack((x, y, one, zero, zero, zero, -u * x, -u * y), 1)
        of_v = torch.stack((zero, zero, zero, x, y, one, -v * x, -v * y), 1)
        unit = x.new_tensor([1, 1, 1, 1, 1, 1, 1 / size[0] ** 2, 1 / size[1] ** 2])
        rows = torch.cat((of_u, of_v)) * unit
        solved = torch.linalg.lstsq(rows, torch.cat((u, v))[:, None], driver="gels").solution[:, 0] * unit
        found.append(torch.cat((solved, one[:1])).reshape(3, 3))
    return torch.stack(found).to(motion)
