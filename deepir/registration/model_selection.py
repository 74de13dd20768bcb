"""Whether homographies are to stand for rigid motions: frames that bend by zoom, tilt, a wide lens that turns."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators.motion_models import increment, nearest_rigid, relative, transform_points
from deepir.registration.alternating_alignment import align, standing
from deepir.registration.block_likelihood import NINE, all_but_one, gains
from deepir.registration.block_vote import reduced, scaled
from deepir.registration.gauss_newton import solved, sums
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import pull

FEWEST, SHORTEST = 3, 64  # frames, and px: fewer and smaller ones are rigid
BAND = 8  # rows of which a step is made, and the next ones left to the other
ALIKE = 0.6  # cosine between what two steps bend from which it may be no chance
LEAST = 0.06  # px, root mean square along the frame's edge: what bends less is rigid
SURE = 20.0  # nats by which frames that bend are the likelier, in all parts but one


def bent(frames: Tensor, weight: Tensor, level: Level, motion: Tensor, rounds: int) -> Tensor:
    """Homographies `(N, 3, 3)` where frames `(N, H, W)` at rigid motions bend; else these, as they are.

    Residuals find the homographies, and are always less with them: pattern and scene follow. So the parts of the frame
    decide, which know nothing of each other, by the likelihood of where each has gone. weight: `(H, W)`.
    """
    if len(motion) < FEWEST or min(level.shape) < SHORTEST or not may_bend(level, motion):
        return motion
    found = align(level, motion, "homography", rounds).motion
    small, factor = reduced(frames, weight)
    gained = gains(small, scaled(relative(motion), factor), scaled(found, factor), NINE)
    return found if all_but_one(gained) > SURE else motion


def may_bend(level: Level, motion: Tensor) -> bool:
    """Whether frames at rigid motions `(N, 3, 3)` would bend, and alike by two halves of their rows.

    A step of Gauss and Newton towards homographies is taken by bands of rows, the even ones and the odd ones: what
    noise makes of it is chance, and another in each. What lines and edges make of it may be the same.
    """
    pattern, _ = standing(level, motion)
    rows = sums(pull(level, pattern, motion), level, "homography")
    odd = torch.arange(len(rows)) // BAND % 2 == 1
    size = max(level.shape) / 2
    one, other = (
        bend(level, relative(increment("homography", solved(rows[half]), size) @ motion))
        for half in (odd, ~odd)
    )
    both = float((one * other).sum())
    return both > max(ALIKE * float(one.norm() * other.norm()), LEAST**2 * one[:, 0].numel())


def bend(level: Level, motion: Tensor) -> Tensor:
    """How far motions `(N, 3, 3)` take points along the frame's edge from where rigid ones do, in px: (N - 1, 2, 8)."""
    h, w = (side / 2 for side in level.shape)
    points = [(x * w, y * h, 1.0) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y]
    at = torch.tensor(points, dtype=motion.dtype).T
    return transform_points(motion[1:], at) - transform_points(nearest_rigid(motion[1:]), at)
