"""Whether homographies are to stand for rigid motions: frames that bend by zoom, tilt, a wide lens that turns."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import carried, increment, nearest_rigid, relative
from deepir.registration.alternating_alignment import align, estimate_pattern
from deepir.registration.block_likelihood import GRID_3X3, block_log_ratios, leave_best_out_sum
from deepir.registration.block_vote import change_pixel_size, likelihood_frames
from deepir.registration.gauss_newton import normal_equations, solve_normal_equations
from deepir.registration.pyramid import Level
from deepir.registration.warp_back import warp_to_reference


@dataclass(frozen=True)
class HomographyCriteria:
    """When homographies replace rigid motions."""

    min_frames: int = 3
    min_side: int = 64  # px
    band_rows: int = 8  # rows of a band; the two half steps use alternate bands
    min_cosine: float = 0.6  # between the non-rigid displacements of the two half steps
    min_rms: float = 0.06  # px along the frame's edge; smaller non-rigid displacements are neglected
    min_nats: float = 20.0  # log-likelihood ratio in sum over all blocks but the best


HOMOGRAPHY = HomographyCriteria()


def select_homography(
    frames: Tensor, weight: Tensor, level: Level, motion: Tensor, max_rounds: int
) -> Tensor:
    """Homographies `(N, 3, 3)` where frames `(N, H, W)` at rigid motions bend; else these, as they are.

    Residuals find the homographies, and are always less with them: pattern and scene follow. So the parts of the frame
    decide, which know nothing of each other, by the likelihood of where each has gone. weight: `(H, W)`.
    """
    if (
        len(motion) < HOMOGRAPHY.min_frames
        or min(level.shape) < HOMOGRAPHY.min_side
        or not half_steps_agree(level, motion)
    ):
        return motion
    homography = align(level, motion, "homography", max_rounds).motion
    reduced, factor = likelihood_frames(frames, weight)
    block_ratios = block_log_ratios(
        reduced, change_pixel_size(relative(motion), factor), change_pixel_size(homography, factor), GRID_3X3
    )
    return homography if leave_best_out_sum(block_ratios) > HOMOGRAPHY.min_nats else motion


def half_steps_agree(level: Level, motion: Tensor) -> bool:
    """Whether frames at rigid motions `(N, 3, 3)` would bend, and alike by two halves of their rows.

    A step of Gauss and Newton towards homographies is taken by bands of rows, the even ones and the odd ones: what
    noise makes of it is chance, and another in each. What lines and edges make of it may be the same.
    """
    pattern, _ = estimate_pattern(level, motion)
    row_equations = normal_equations(warp_to_reference(level, pattern, motion), level, "homography")
    odd = torch.arange(len(row_equations)) // HOMOGRAPHY.band_rows % 2 == 1
    half_size = max(level.shape) / 2
    odd_displacement, even_displacement = (
        nonrigid_displacement(
            level,
            relative(
                increment("homography", solve_normal_equations(row_equations[half]), half_size) @ motion
            ),
        )
        for half in (odd, ~odd)
    )
    inner_product = float((odd_displacement * even_displacement).sum())
    return inner_product > max(
        HOMOGRAPHY.min_cosine * float(odd_displacement.norm() * even_displacement.norm()),
        HOMOGRAPHY.min_rms**2 * odd_displacement[:, 0].numel(),
    )


def nonrigid_displacement(level: Level, motion: Tensor) -> Tensor:
    """How far motions `(N, 3, 3)` take points along the frame's edge from where rigid ones do, in px: (N - 1, 2, 8)."""
    h, w = (side / 2 for side in level.shape)
    coordinates = [(x * w, y * h, 1.0) for y in (-1, 0, 1) for x in (-1, 0, 1) if x or y]
    edge_points = torch.tensor(coordinates, dtype=motion.dtype).T
    return carried(motion[1:], edge_points) - carried(nearest_rigid(motion[1:]), edge_points)
