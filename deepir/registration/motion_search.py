"""Where the frames of a burst are: searched, refined by residuals, then by likelihood where their parts like that."""

from __future__ import annotations

from dataclasses import dataclass, replace

from torch import Tensor

from deepir.operators.motion_models import relative
from deepir.registration.alternating_alignment import Alignment, align, estimate_pattern
from deepir.registration.block_likelihood import GRID_3X3, block_log_ratios, maximise_rotation_likelihood
from deepir.registration.block_vote import (
    change_pixel_size,
    corner_distance,
    has_linear_part,
    likelihood_frames,
    select_by_blocks,
)
from deepir.registration.frame_groups import largest_consistent_set
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
