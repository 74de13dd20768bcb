"""Where the frames of a burst are: searched, refined by residuals, then by likelihood where their parts like that.

Whether homographies are to stand for rigid motions: frames that bend by zoom, tilt, a wide lens that turns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import carried, increment, nearest_rigid, relative
from deepir.registration.alignment import (
    Alignment,
    align,
    estimate_pattern,
    normal_equations,
    solve_normal_equations,
    warp_to_reference,
)
from deepir.registration.block_likelihood import (
    GRID_3X3,
    block_log_ratios,
    change_pixel_size,
    corner_distance,
    has_linear_part,
    leave_best_out_sum,
    likelihood_frames,
    maximise_rotation_likelihood,
    select_by_blocks,
)
from deepir.registration.frame_selection import largest_consistent_set
from deepir.registration.pyramid import Level, build_level

SEARCH_SIDE = 160  # px; longer side of the level of the coarse search, at most
MAX_FINAL_PIXELS = 400_000  # px; larger frames are registered at half their size
MAX_ROUNDS = 8  # Gauss-Newton rounds of the alignment, over all levels
LAST_LEVEL_ROUNDS = 2  # of these, rounds on the last level if a level of half the size precedes it


@dataclass(frozen=True)
class RotationCriteria:
    """When a rotation that maximises the block-wise likelihood replaces that of least residuals."""

    image_side: int = 100  # px; longer side of the block means on which the likelihood is computed
    min_frames: int = 4  # with three, noise decides
    min_side: int = 48  # px; a ninth of a smaller frame holds too few waves
    n_left_out: int = 3  # of nine blocks, those that gain most: a moving object may cover them
    min_change: float = (
        0.4  # px at the corners of the block means; the likelihood is no more accurate than this
    )


ROTATION = RotationCriteria()


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


@dataclass(frozen=True)
class MotionEstimate:
    """Frames and where they are.

    frames, flat: `(N, H, W)`, as they are and flat. coarse: the level of the search. clear: `(N,)`, how clearly they
    show the scene that most of them show; used: `(N,)` bool, which do. found: what the search found of these.
    motion: `(M, 3, 3)`, where these M are in the end.
    """

    frames: Tensor
    preprocessed: Tensor
    coarse_level: Level
    match_score: Tensor
    used: Tensor
    alignment: Alignment
    motion: Tensor


def estimate_motion(frames: Tensor, preprocessed: Tensor, weight: Tensor, model: str) -> MotionEstimate:
    """Where frames `(N, H, W)` that show one scene are; weight: `(H, W)`, zero where a pixel is bad."""
    return refine(coarse_search(frames, preprocessed, weight, model), weight, model)


def coarse_search(frames: Tensor, preprocessed: Tensor, weight: Tensor, model: str) -> MotionEstimate:
    """The same as the search finds them, nearly."""
    coarse_level = search_level(preprocessed, weight)
    selection = largest_consistent_set(coarse_level, "shift" if model == "shift" else "rigid")
    used, alignment = selection.used, selection.alignment
    return MotionEstimate(
        frames, preprocessed, coarse_level, selection.match_score, used, alignment, alignment.motion
    )


def refine(estimate: MotionEstimate, weight: Tensor, model: str) -> MotionEstimate:
    """Frames that are nearly placed, by the least residuals, or by likelihood."""
    used, initial = estimate.used, estimate.motion
    if used.sum() < 2:
        return estimate
    kept = slice(None) if used.all() else used  # no copy of all
    levels = final_levels(estimate.preprocessed[kept], weight, estimate.coarse_level.factor)
    refined = align_levels(levels, initial, model)
    selected = select_by_blocks(estimate.frames[kept], weight, refined, model)
    # Parts of frames that turn are not like each other, wherever they are put: a vote says little there.
    level = estimate.coarse_level.subset(used)
    if selected is not refined and (
        not has_linear_part(refined, weight) or misfit_at(level, selected) < misfit_at(level, refined)
    ):
        refined = selected
    if model == "rigid":
        refined = refine_rotation(estimate.frames[kept], weight, levels, refined)
    return replace(estimate, motion=refined)


def refine_rotation(frames: Tensor, weight: Tensor, levels: list[Level], motion: Tensor) -> Tensor:
    """Motions `(N, 3, 3)`, or those that residuals find from the likeliest turns, if the frame's parts like these."""
    proposed = most_likely_rotations(frames, weight, motion)
    if proposed is motion:
        return motion
    reduced, factor = likelihood_frames(frames, weight, ROTATION.image_side)
    before, proposed_reduced = (change_pixel_size(relative(each), factor) for each in (motion, proposed))
    if corner_distance(before, proposed_reduced, reduced) < ROTATION.min_change:
        return motion
    refined = align_levels(levels, proposed, "rigid")
    after = change_pixel_size(relative(refined), factor)
    block_ratios = sorted(block_log_ratios(reduced, before, after, GRID_3X3))
    return refined if sum(block_ratios[: -ROTATION.n_left_out]) > 0 else motion


def most_likely_rotations(frames: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """The likeliest turns of frames `(N, H, W)` near motions `(N, 3, 3)`; the same of frames that say too little."""
    if len(frames) < ROTATION.min_frames or min(weight.shape) < ROTATION.min_side:
        return motion
    reduced, factor = likelihood_frames(frames, weight, ROTATION.image_side)
    return change_pixel_size(
        maximise_rotation_likelihood(reduced, change_pixel_size(relative(motion), factor)), 1 / factor
    )


def misfit_at(level: Level, motion: Tensor) -> float:
    """The share of the frames' mean square that neither scene nor pattern explain at these motions."""
    return estimate_pattern(level, motion)[1]


def search_level(preprocessed: Tensor, weight: Tensor) -> Level:
    """The level of flat frames `(N, H, W)` on which they are searched."""
    return build_level(preprocessed, weight, power_of_two_factor(max(weight.shape) / SEARCH_SIDE))


def final_levels(preprocessed: Tensor, weight: Tensor, coarse_factor: int) -> list[Level]:
    """The levels of flat frames `(N, H, W)` on which they are registered in the end, after one of factor `coarse`."""
    last_factor = power_of_two_factor((weight.numel() / MAX_FINAL_PIXELS) ** 0.5)
    factors = (2 * last_factor, last_factor) if 2 * last_factor < coarse_factor else (last_factor,)
    return [build_level(preprocessed, weight, factor) for factor in factors]


def align_levels(levels: list[Level], motion: Tensor, model: str) -> Tensor:
    """The motion after rounds on these levels, fewer on the last of two."""
    for level, rounds in zip(
        levels,
        (MAX_ROUNDS - LAST_LEVEL_ROUNDS, LAST_LEVEL_ROUNDS) if levels[1:] else (MAX_ROUNDS,),
        strict=True,
    ):
        motion = align(level, motion, model, rounds).motion
    return motion


def power_of_two_factor(ratio: float) -> int:
    """The least power of two that is at least `ratio`, and at least one."""
    factor = 1
    while factor < ratio:
        factor *= 2
    return factor


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
