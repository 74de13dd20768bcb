"""Places of frames through which somebody walks: he registers, too, and often better than a plain scene does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity, relative
from deepir.registration.alignment import Alignment, estimate_pattern
from deepir.registration.block_likelihood import (
    DISTINCT_DISTANCE,
    GRID_2X2,
    block_log_ratios,
    change_pixel_size,
    corner_distance,
    has_linear_part,
    leave_best_out_sum,
    likelihood_frames,
)
from deepir.registration.motion_search import (
    MotionEstimate,
    coarse_search,
    final_levels,
    misfit_at,
    most_likely_rotations,
    refine,
    search_level,
)
from deepir.registration.moving_object_masks import detect_moving_objects, inpaint_background, inpaint_mean
from deepir.registration.robust_score import (
    MIN_CLEAR_GAIN,
    log_likelihood_ratio,
    reregister_worst_frames,
    robust_nll,
)
from deepir.registration.shift_likelihood import integer_shifts, maximise_shift_likelihood


@dataclass(frozen=True)
class FitCriteria:
    """When motions explain the frames well, so that no moving object needs to be searched."""

    good_nll: float = 0.7  # nats per sample; less: one scene and little else
    poor_nll: float = 1.0  # nats per sample; more: not explained. Between the two the next ratio decides
    max_rest_ratio: float = (
        0.08  # misfit over that at rest, on the final level; edges of dark scenes reach less
    )
    rest_distance: float = 0.5  # px from the median shift; a frame that is closer seems to be at rest


@dataclass(frozen=True)
class CandidateCriteria:
    """When a candidate motion replaces the estimate in the presence of moving objects."""

    max_loss: float = (
        0.25  # nats per sample of the robust score, if the blocks' likelihood prefers the candidate
    )
    max_rest_ratio: float = 0.7  # misfit over that at rest, the moving objects inpainted
    max_rotated_ratio: float = 0.95  # misfit over that of the estimate, if frames rotate
    max_swept: float = (
        3 / 8
    )  # of the frame; where objects pass through more, they are inpainted, not left out
    min_background: float = 0.4  # of the frame; through the rest, objects pass


FIT = FitCriteria()
CANDIDATE = CandidateCriteria()


def register_beside_moving_objects(
    estimate: MotionEstimate, weight: Tensor, model: str, missing: Tensor | None = None
) -> MotionEstimate:
    """Frames that are placed once more without whoever walks through them, if that explains more of them.

    weight: `(H, W)`, zero where a pixel is bad. holes: `(N, H, W)` bool, samples that nothing is known of, as if
    somebody stood there; in the end what the other frames show is filled in.
    """
    mask = (
        detect_moving_objects(estimate.preprocessed)
        if len(estimate.frames) > 2
        else torch.zeros(estimate.preprocessed.shape, dtype=torch.bool)
    )
    mask = mask if missing is None else mask | missing
    frames, preprocessed, level = (
        torch.where(weight > 0, estimate.frames.float(), 0.0),
        estimate.preprocessed,
        estimate.coarse_level,
    )
    if len(frames) > 2 and mask.any():
        frames_lost = missing is not None and not estimate.used.all()
        if frames_lost or not is_well_explained(estimate, weight):
            for candidate in alternative_estimates(estimate, frames, mask, weight, model):
                repaired = with_motion(
                    candidate, reregister_worst_frames(level, full_motion(candidate), model)
                )
                gain = log_likelihood_ratio(level, full_motion(estimate), full_motion(repaired))
                if gain > MIN_CLEAR_GAIN or (
                    gain > -CANDIDATE.max_loss and is_likelier(estimate, repaired, frames, mask, weight)
                ):
                    estimate = refine_with_inpainting(repaired, frames, preprocessed, mask, weight, model)
    return (
        estimate
        if missing is None
        else refine_with_inpainting(estimate, frames, preprocessed, missing, weight, model)
    )


def is_well_explained(estimate: MotionEstimate, weight: Tensor) -> bool:
    """Whether its motions explain most of the frames; that, or less of them in samples but in squares next to all.

    Not where all but one seem to stand still: that one may have lost lines on its way, and all follow the pattern.
    """
    shifts = full_motion(estimate)[estimate.used][:, :2, 2]
    resting = (shifts - shifts.median(0).values).norm(dim=1) < FIT.rest_distance
    if len(shifts) > 3 and resting.sum() == len(shifts) - 1:
        return False
    nll = robust_nll(estimate.coarse_level, full_motion(estimate))
    if not FIT.good_nll < nll < FIT.poor_nll:
        return nll <= FIT.good_nll
    level = final_levels(estimate.preprocessed, weight, estimate.coarse_level.factor)[-1].subset(
        estimate.used
    )  # there, what moves by a few px differs
    return misfit_at(level, estimate.motion) < FIT.max_rest_ratio * misfit_at(
        level, identity(len(estimate.motion))
    )


def full_motion(estimate: MotionEstimate) -> Tensor:
    """Its motions `(N, 3, 3)`, NaN where a frame is not used."""
    motion = torch.full((len(estimate.used), 3, 3), torch.nan, dtype=torch.float64)
    motion[estimate.used] = relative(estimate.motion)
    return motion


def with_motion(estimate: MotionEstimate, motion: Tensor) -> MotionEstimate:
    """The same at motions `(N, 3, 3)`, NaN where a frame is not used."""
    used = motion.isfinite().all((1, 2))
    return replace(estimate, used=used, motion=relative(motion[used]))


def alternative_estimates(
    estimate: MotionEstimate, frames: Tensor, mask: Tensor, weight: Tensor, model: str
) -> Iterator[MotionEstimate]:
    """Where else frames `(N, H, W)` may be: as if he were not there; by what is beside his way, if that is enough.

    Only what the search puts elsewhere is settled there: where it finds the same, he did no harm.
    """
    inpainted, preprocessed = (inpaint_mean(each, mask, weight) for each in (frames, estimate.preprocessed))
    background = weight * ~mask.any(0)
    candidate = coarse_search(inpainted, preprocessed, weight, model)
    if any_differs := differs(estimate, candidate):
        yield refine(candidate, weight, model)
    if background.mean() > CANDIDATE.min_background:
        candidate = coarse_search(frames, estimate.preprocessed * (background > 0), background, model)
        if differs(estimate, candidate):
            any_differs = True
            yield refine(candidate, background, model)
        if any_differs and estimate.used.sum() > 2:
            yield replace(estimate, motion=most_likely_motion(frames[estimate.used], background, model))


def differs(estimate: MotionEstimate, other: MotionEstimate) -> bool:
    """Whether others of the frames are used, or these are in other places."""
    if not torch.equal(estimate.used, other.used):
        return True
    return (
        len(estimate.motion) > 1
        and corner_distance(relative(estimate.motion), relative(other.motion), estimate.frames)
        > DISTINCT_DISTANCE
    )


def most_likely_motion(frames: Tensor, weight: Tensor, model: str) -> Tensor:
    """The likeliest motions `(N, 3, 3)` of frames `(N, H, W)`: shifts, or turns where these are others."""
    reduced, factor = likelihood_frames(frames, weight)
    motion = identity(len(reduced))
    motion[1:, :2, 2] = factor * torch.from_numpy(maximise_shift_likelihood(reduced, integer_shifts(reduced)))
    if model != "rigid":
        return motion
    rotated = most_likely_rotations(frames, weight, motion)
    return rotated if corner_distance(motion, rotated, frames) > DISTINCT_DISTANCE else motion


def is_likelier(
    estimate: MotionEstimate, candidate: MotionEstimate, frames: Tensor, mask: Tensor, weight: Tensor
) -> bool:
    """Whether frames `(N, H, W)` are likelier at the motions of `other`; if these are the same, whether it has more.

    Beside his way, if that is enough. Else he is filled in, by either's motions in turn, for which that speaks. None
    is better that is of fewer frames, nor of more which it does not explain.
    """
    common, n_before, n_after = (
        estimate.used & candidate.used,
        int(estimate.used.sum()),
        int(candidate.used.sum()),
    )
    if n_after >= n_before and common.sum() > 2:
        motions = [relative(each.motion[common[each.used]]) for each in (estimate, candidate)]
        level = search_level(inpaint_mean(estimate.preprocessed, mask, weight), weight).subset(common)
        misfit_at_rest, misfit_before, misfit_after = (
            misfit_at(level, each) for each in (identity(int(common.sum())), *motions)
        )
        swept = mask[common].any(0)
        if swept.float().mean() < CANDIDATE.max_swept:
            reduced_sets = [likelihood_frames(frames[common], weight * ~swept)]
        else:
            reduced_sets = [
                likelihood_frames(inpaint_background(frames[common], mask[common], weight, each), weight)
                for each in motions
            ]
        reduced, factor = reduced_sets[0]
        before, after = (change_pixel_size(each, factor) for each in motions)
        if factor * corner_distance(before, after, reduced) > DISTINCT_DISTANCE:
            block_ratios = [block_log_ratios(each, before, after, GRID_2X2) for each, _ in reduced_sets]
            accepted = leave_best_out_sum([sum(part) for part in zip(*block_ratios, strict=True)]) > 0
            # Parts of frames that turn are not like each other, wherever they are put: their vote says little.
            limit = (
                CANDIDATE.max_rotated_ratio * misfit_before
                if has_linear_part(motions[0], weight)
                else max(misfit_before, CANDIDATE.max_rest_ratio * misfit_at_rest)
            )
            return accepted and misfit_after < limit
    return n_after > n_before and is_well_explained(candidate, weight)


def refine_with_inpainting(
    estimate: MotionEstimate, frames: Tensor, preprocessed: Tensor, mask: Tensor, weight: Tensor, model: str
) -> MotionEstimate:
    """The same, refined where he is filled in by what its motions say of his place."""
    motion = identity(len(frames))
    motion[estimate.used] = estimate.motion
    frames, preprocessed = (inpaint_background(each, mask, weight, motion) for each in (frames, preprocessed))
    level = search_level(preprocessed, weight)
    alignment = Alignment(estimate.motion, *estimate_pattern(level.subset(estimate.used), estimate.motion))
    return refine(
        replace(estimate, frames=frames, preprocessed=preprocessed, coarse_level=level, alignment=alignment),
        weight,
        model,
    )
