"""Whether homographies are to stand for rigid motions: frames that bend by zoom, tilt, a wide lens that turns."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.align import standing
from deepir.registration.motion import increment, nearest_rigid, relative
from deepir.registration.pull import pull
from deepir.registration.pyramid import Level
from deepir.registration.refine import solved, sums

SHORTEST = 64  # px: smaller frames are rigid
BAND = 8  # rows of which a step is made, and the next ones left to the other
ALIKE = 0.7  # cosine between what two steps bend from which it is no chance,
FEW = 1.3  # and, of few frames, this over the root of one less: 0.92 of three, never of two
LEAST = 0.06  # px, root mean square along the frame's edge: what bends less is rigid


def bends(level: Level, motion: Tensor) -> bool:
    """Whether frames at rigid motions `(N, 3, 3)` would bend, and alike by two halves of their rows.

    A step of Gauss and Newton towards homographies is taken by bands of rows, the even ones and the odd ones: what
    noise and pattern make of it is chance, and another in each.
    """
    if level.factor * min(level.shape) < SHORTEST:
        return False
    pattern, _ = standing(level, motion)
    rows = sums(pull(level, pattern, motion), level, "homography")
    odd = torch.arange(len(rows)) // BAND % 2 == 1
    size = max(level.shape) / 2
    one, other = (
        bend(level, relative(increment("homography", solved(rows[half]), size) @ motion))
        for half in (odd, ~odd)
    )
    both = float((one * other).sum())
    alike = both > max(ALIKE, FEW / len(one) ** 0.5) * float(one.norm() * other.norm())
    return alike and both > LEAST**2 * one[:, 0].numel()


def bend(level: Level, motion: Tensor) -> Tensor:
    """How far motions `(N, 3, 3)` take points along the frame's edge from where rigid ones do, in px: (N - 1, 2, 8)."""
    h, w = (level.factor * side / 2 for side in level.shape)
    points = [(x * w, y * h, 1.0) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y]
    at = torch.tensor(points, dtype=motion.dtype).T
    moved, rigid = motion[1:] @ at, nearest_rigid(motion[1:]) @ at
    return moved[:, :2] / moved[:, 2:] - rigid[:, :2]
