"""Motions of frames that show one scene: coarse search, refinement by residuals, then selection by likelihood.

`coarse_search` searches on a coarse level. `refine` aligns on the finest one or two (`align_levels`), and replaces
shifts (`select_by_blocks`) and rotations (`refine_rotation`) where the likelihood of most blocks of the frame prefers
others. `select_homography` asks whether rigid motions are enough.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import PARAMETERS, relative
from deepir.registration.alignment import Alignment, accept_by_misfit, align
from deepir.registration.block_likelihood import (
    GRID_3X3,
    accept_by_blocks,
    block_log_ratios,
    change_pixel_size,
    corner_distance,
    has_linear_part,
    likelihood_frames,
    maximise_rotation_likelihood,
    select_by_blocks,
)
from deepir.registration.frame_selection import largest_consistent_set
from deepir.registration.preprocess import Level, build_level

SEARCH_SIDE = 160  # px; longer side of the level of the coarse search, at most
MAX_FINAL_PIXELS = 400_000  # px; larger frames are registered at half their size
MIN_FRAMES = 3  # for homographies
MAX_ROUNDS = 8  # Gauss-Newton rounds of the alignment, over all levels
ROTATION_SIDE = 100  # px; longer side of the block means on which the likelihood of rotations is computed


@dataclass(frozen=True)
class MotionEstimate:
    """Frames of a burst and their motions.

    frames, preprocessed: `(N, H, W)`, zero where the weight is. weight: `(H, W)`, zero where a pixel is bad. model:
    motion model. coarse_level: the level of the coarse search. match_score: `(N,)`, height of each frame's correlation
    peak over the detection threshold. used: `(N,)` bool, True for the M frames that show one scene. alignment: of
    these, on the coarse level. motion: `(M, 3, 3)`, their refined motions, centred px.
    """

    frames: Tensor
    preprocessed: Tensor
    weight: Tensor
    model: str
    coarse_level: Level
    match_score: Tensor
    used: Tensor
    alignment: Alignment
    motion: Tensor

    @property
    def full_motion(self) -> Tensor:
        """Motions `(N, 3, 3)` of all frames relative to the first that is used; NaN where a frame is not used."""
        motion = torch.full((len(self.used), 3, 3), torch.nan, dtype=torch.float64)
        motion[self.used] = relative(self.motion)
        return motion

    def with_motion(self, motion: Tensor) -> MotionEstimate:
        """The estimate with other motions `(N, 3, 3)`, NaN where a frame is not used."""
        used = motion.isfinite().all((1, 2))
        return replace(self, used=used, motion=relative(motion[used]))


def coarse_search(frames: Tensor, preprocessed: Tensor, weight: Tensor, model: str) -> MotionEstimate:
    """Find the frames that show one scene, and initial motions, on the coarse level.

    Arguments as the attributes of `MotionEstimate`.
    """
    level = search_level(preprocessed, weight)
    found = largest_consistent_set(level, "shift" if model == "shift" else "rigid")
    alignment = found.alignment
    return MotionEstimate(
        frames, preprocessed, weight, model, level, found.match_score, found.used, alignment, alignment.motion
    )


def refine(estimate: MotionEstimate) -> MotionEstimate:
    """Refine initial motions: least residuals on fine levels, then shifts and rotations by block-wise likelihood.

    Blocks of frames that rotate or stretch do not shift, whatever the motion. So there, shifts that the blocks prefer
    must lower the misfit, too.
    """
    used, weight, model = estimate.used, estimate.weight, estimate.model
    if used.sum() < 2:
        return estimate
    kept = slice(None) if used.all() else used  # no copy of all
    frames, level = estimate.frames[kept], estimate.coarse_level.subset(used)
    levels = final_levels(estimate.preprocessed[kept], weight, estimate.coarse_level.factor)
    motion = align_levels(levels, estimate.motion, model)
    selected = select_by_blocks(frames, weight, motion, model)
    if selected is not motion and (not has_linear_part(motion, weight) or accept_by_misfit(level, selected, motion)):
        motion = selected
    if model == "rigid":
        motion = refine_rotation(frames, weight, levels, motion)
    return replace(estimate, motion=motion)


def refine_rotation(frames: Tensor, weight: Tensor, levels: list[Level], motion: Tensor) -> Tensor:
    """Replace rigid motions by those aligned from the most likely rotations, if the blocks' likelihood accepts them.

    The motions `(N, 3, 3)`, of least residuals, are those of frames `(N, H, W)` of weight `(H, W)`; `levels` hold the
    same frames on the final levels.
    """
    most_likely = most_likely_rotations(frames, weight, motion)
    if most_likely is motion:
        return motion
    reduced, factor = likelihood_frames(frames, weight, ROTATION_SIDE)
    before, start = (change_pixel_size(relative(each), factor) for each in (motion, most_likely))
    if corner_distance(before, start, reduced) < 0.4:  # px of the block means; accuracy of the likelihood
        return motion
    refined = align_levels(levels, most_likely, "rigid")
    after = change_pixel_size(relative(refined), factor)
    return refined if accept_by_blocks(block_log_ratios(reduced, before, after, GRID_3X3), n_left_out=3) else motion


def most_likely_rotations(frames: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """Maximum-likelihood rigid motions `(N, 3, 3)` of frames `(N, H, W)` of weight `(H, W)`, near given ones.

    The object `motion` itself if frames are too few or too small: with three, noise decides, and a ninth of a smaller
    frame holds too few waves.
    """
    if len(frames) < 4 or min(weight.shape) < 48:  # px
        return motion
    reduced, factor = likelihood_frames(frames, weight, ROTATION_SIDE)
    start = change_pixel_size(relative(motion), factor)
    return change_pixel_size(maximise_rotation_likelihood(reduced, start), 1 / factor)


def search_level(preprocessed: Tensor, weight: Tensor) -> Level:
    """Level of the coarse search, of preprocessed frames `(N, H, W)` of weight `(H, W)`."""
    return build_level(preprocessed, weight, power_of_two(max(weight.shape) / SEARCH_SIDE))


def final_levels(preprocessed: Tensor, weight: Tensor, coarse_factor: int) -> list[Level]:
    """Levels of the alignment after the coarse search: the finest, preceded by one of half its size if finer than that.

    Of preprocessed frames `(N, H, W)` of weight `(H, W)`. The coarse search had `coarse_factor` px per px of its level.
    """
    last = power_of_two((weight.numel() / MAX_FINAL_PIXELS) ** 0.5)
    factors = (2 * last, last) if 2 * last < coarse_factor else (last,)
    return [build_level(preprocessed, weight, factor) for factor in factors]


def align_levels(levels: list[Level], motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)` aligned on one or two levels in turn, from initial motions `(N, 3, 3)`."""
    last = 2 if levels[1:] else MAX_ROUNDS  # rounds on the last level
    rounds = (MAX_ROUNDS - last, last)[-len(levels) :]
    for level, max_rounds in zip(levels, rounds, strict=True):
        motion = align(level, motion, model, max_rounds).motion
    return motion


def power_of_two(ratio: float) -> int:
    """Smallest power of two that is at least `ratio`, and at least one."""
    return 1 << max(math.ceil(ratio) - 1, 0).bit_length()


def select_homography(frames: Tensor, weight: Tensor, level: Level, motion: Tensor) -> Tensor:
    """Replace rigid motions by homographies (zoom, tilt, a wide lens that rotates) if the blocks' likelihood accepts.

    Homographies always lower the residuals, since scene and pattern adapt. So the decision is that of blocks, each of
    which has its own likelihood, by Akaike's criterion. The rigid motions `(N, 3, 3)` are those of frames `(N, H, W)`
    of weight `(H, W)`; `level` holds the same frames on the final level.
    """
    if len(motion) < MIN_FRAMES:
        return motion
    homography = align(level, motion, "homography", MAX_ROUNDS).motion
    reduced, factor = likelihood_frames(frames, weight)
    before, after = change_pixel_size(relative(motion), factor), change_pixel_size(homography, factor)
    block_ratios = block_log_ratios(reduced, before, after, GRID_3X3)
    price = (PARAMETERS["homography"] - PARAMETERS["rigid"]) * (len(motion) - 1)  # a nat each: Akaike's criterion
    return homography if accept_by_blocks(block_ratios, min_nats=price) else motion
