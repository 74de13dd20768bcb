"""Objects that move by themselves, and their masks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch
from scipy.ndimage import binary_dilation, binary_opening, label, uniform_filter
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.operators.motion_models import identity, relative
from deepir.registration.alignment import Alignment, accept_by_misfit, estimate_pattern
from deepir.registration.block_likelihood import (
    DISTINCT_DISTANCE,
    GRID_2X2,
    LIKELIHOOD_SIDE,
    accept_by_blocks,
    block_log_ratios,
    change_pixel_size,
    corner_distance,
    has_linear_part,
    likelihood_frames,
)
from deepir.registration.motion_search import (
    MotionEstimate,
    coarse_search,
    final_levels,
    most_likely_rotations,
    refine,
    search_level,
)
from deepir.registration.preprocess import Level, block_mean, sample
from deepir.registration.robust_score import MIN_CLEAR_GAIN, log_likelihood_ratio, reregister_worst_frames, robust_nll
from deepir.registration.shift_likelihood import ShiftLikelihood, integer_shifts, maximise

#: Nats per sample of the robust score. Below the first: one scene and little else; above the second: not explained.
GOOD_NLL, POOR_NLL = 0.7, 1.0


def moving_object_mask(preprocessed: Tensor) -> Tensor:
    """Samples `(N, H, W)`, bool, of moving objects: thick regions of large deviation from the temporal median.

    By hysteresis thresholding, then morphology, on frames reduced to a longer side of at most `LIKELIHOOD_SIDE` px.
    """
    h, w = preprocessed.shape[1:]
    factor = max(1, -(-max(h, w) // LIKELIHOOD_SIDE))
    reduced = block_mean(preprocessed, factor)
    reduced = reduced - reduced.flatten(1).median(1).values[:, None, None]
    deviation = (reduced - reduced.median(0).values).numpy()
    change = np.abs(uniform_filter(deviation, (0, 3, 3)))  # px
    sigma = MAD_TO_SIGMA * float(np.median(change))
    low, high = change > 8 * sigma, change > 16 * sigma  # all samples of an object, and one of them
    candidates = binary_opening(low, np.ones((1, 5, 5)))  # px; thinner: edges of a scene that moves
    neighbours = np.arange(27).reshape(3, 3, 3) // 9 == 1  # the eight of a sample, in its own frame
    regions, _ = label(candidates, neighbours)
    mask = binary_dilation(np.isin(regions, np.unique(regions[candidates & high])), neighbours, iterations=4)  # px
    mask &= mask.mean((1, 2), keepdims=True) < 1 / 3  # of a frame; where more changes, it shows another place
    mask = mask.repeat(factor, 1).repeat(factor, 2)
    padding = (0, 0), (0, h - mask.shape[1]), (0, w - mask.shape[2])
    return torch.from_numpy(np.pad(mask, padding, mode="edge"))


def inpaint_mean(frames: Tensor, mask: Tensor, weight: Tensor) -> Tensor:
    """Replace masked samples of frames `(N, H, W)` by the temporal mean of the others, as if nothing moved.

    The median of each frame is kept. The mask is `(N, H, W)`, bool; the weight `(H, W)`, zero where a pixel is bad.
    """
    levels = frames.flatten(1).median(1).values[:, None, None]
    centred = frames - levels
    return torch.where(mask, _masked_mean(centred, weight * ~mask), centred).add_(levels)


def inpaint_background(frames: Tensor, mask: Tensor, weight: Tensor, motion: Tensor) -> Tensor:
    """Replace masked samples of frames `(N, H, W)` by scene and pattern of the others, at motions `(N, 3, 3)`.

    Scene and pattern are estimated alternately. Where no other frame shows the scene, the temporal mean replaces the
    samples. The median of each frame is kept. The mask is `(N, H, W)`, bool; the weight `(H, W)`, zero where a pixel is
    bad.
    """
    level = Level(1, frames, weight, bool(weight.all()), (weight.shape[0], weight.shape[1]))
    levels = frames.flatten(1).median(1).values[:, None, None]
    centred, visible, inverse = frames - levels, weight * ~mask, torch.linalg.inv(motion)
    mean = _masked_mean(centred, visible)
    interpolated, known = sample(visible, inverse, level)
    is_visible = known * (interpolated > 0.99)  # background only
    n_visible = is_visible.sum(0).clamp_min(1)
    pattern = torch.zeros_like(mean)
    for _ in range(3):
        scene = (sample(centred - pattern, inverse, level)[0] * is_visible).sum(0) / n_visible
        scene = torch.where(is_visible.any(0), scene, mean - pattern)
        expected, known = sample(scene[None], motion, level)
        weights = visible * known
        pattern = ((centred - expected) * weights).sum(0) / weights.sum(0).clamp_min(1)
    return torch.where(mask, torch.where(known > 0, expected + pattern, mean), centred) + levels


def _masked_mean(values: Tensor, visible: Tensor) -> Tensor:
    """Mean `(H, W)` over the visible samples, one or zero `(N, H, W)`, of values `(N, H, W)`; of all if none is."""
    count = visible.sum(0)
    return torch.where(count > 0, (values * visible).sum(0) / count.clamp_min(1), values.mean(0))


def register_beside_moving_objects(estimate: MotionEstimate, missing: Tensor | None = None) -> MotionEstimate:
    """Replace the estimate by candidates that discount moving objects, if these explain more of the frames.

    Samples without data, `missing` `(N, H, W)` bool, are treated as covered by an object, and finally inpainted.
    """
    burst = estimate
    if len(burst.frames) > 2:
        mask = moving_object_mask(burst.preprocessed)
        if missing is not None:
            mask |= missing
        frames_lost = missing is not None and not burst.used.all()
        if mask.any() and (frames_lost or not is_well_explained(burst)):
            level = burst.coarse_level
            for proposed in alternative_estimates(burst, mask):
                motion = reregister_worst_frames(level, proposed.full_motion, proposed.model)
                candidate = proposed.with_motion(motion)
                gain = log_likelihood_ratio(level, estimate.full_motion, candidate.full_motion)
                is_better, is_little_worse = gain > MIN_CLEAR_GAIN, gain > -0.25  # nats per sample
                if is_better or (is_little_worse and is_likelier(estimate, candidate, burst.frames, mask)):
                    estimate = refine_inpainted(candidate, burst, mask)
    return estimate if missing is None else refine_inpainted(estimate, burst, missing)


def is_well_explained(estimate: MotionEstimate) -> bool:
    """Whether the motions explain most samples of the frames, or, of many poorly explained ones, most of the power.

    Not if all frames but one seem to be at rest: lines missing in that one may have locked the others to the pattern.
    """
    shifts = estimate.full_motion[estimate.used][:, :2, 2]
    is_resting = (shifts - shifts.median(0).values).norm(dim=1) < 0.5  # px
    if len(shifts) > 3 and is_resting.sum() == len(shifts) - 1:
        return False
    nll = robust_nll(estimate.coarse_level, estimate.full_motion)
    if not GOOD_NLL < nll < POOR_NLL:
        return nll <= GOOD_NLL
    # Of the final level, which motions of a few px change, too; of that at rest, edges of dark scenes reach less.
    levels = final_levels(estimate.preprocessed, estimate.weight, estimate.coarse_level.factor)
    rest = identity(len(estimate.motion))
    return accept_by_misfit(levels[-1].subset(estimate.used), estimate.motion, rest, max_ratio=0.08)


def alternative_estimates(estimate: MotionEstimate, mask: Tensor) -> Iterator[MotionEstimate]:
    """Propose motions that discount moving objects, if a search that does so differs from the estimate.

    In order: with the objects, samples of the mask `(N, H, W)` bool, inpainted by the temporal mean; from the
    background; of maximum likelihood, from the background.
    """
    frames, weight, model = estimate.frames, estimate.weight, estimate.model
    inpainted, preprocessed = (inpaint_mean(each, mask, weight) for each in (frames, estimate.preprocessed))
    candidate = coarse_search(inpainted, preprocessed, weight, model)
    if any_differs := is_distinct(estimate, candidate):
        yield refine(candidate)
    background = weight * ~mask.any(0)
    if background.mean() > 0.4:  # of the frame; a smaller one is not searched
        candidate = coarse_search(frames, estimate.preprocessed * (background > 0), background, model)
        if is_distinct(estimate, candidate):
            any_differs = True
            yield replace(refine(candidate), weight=weight)
        if any_differs and estimate.used.sum() > 2:
            yield replace(estimate, motion=most_likely_motion(frames[estimate.used], background, model))


def is_distinct(estimate: MotionEstimate, other: MotionEstimate) -> bool:
    """Whether two estimates use different frames, or motions that are distinct at the corners."""
    if not torch.equal(estimate.used, other.used):
        return True
    motions = relative(estimate.motion), relative(other.motion)
    return len(estimate.motion) > 1 and corner_distance(*motions, estimate.frames) > DISTINCT_DISTANCE


def most_likely_motion(frames: Tensor, weight: Tensor, model: str) -> Tensor:
    """Maximum-likelihood shifts, or rigid motions where these are distinct from shifts, relative to the first frame.

    Motions `(N, 3, 3)` of frames `(N, H, W)` of weight `(H, W)`. Only the model "rigid" includes rotations.
    """
    reduced, factor = likelihood_frames(frames, weight)
    motion = identity(len(reduced))
    motion[1:, :2, 2] = factor * torch.from_numpy(maximise(ShiftLikelihood(reduced), integer_shifts(reduced)))
    if model != "rigid":
        return motion
    rigid = most_likely_rotations(frames, weight, motion)
    return rigid if corner_distance(motion, rigid, frames) > DISTINCT_DISTANCE else motion


def is_likelier(estimate: MotionEstimate, candidate: MotionEstimate, frames: Tensor, mask: Tensor) -> bool:
    """Whether the block-wise likelihood of the background accepts a candidate, and its misfit is low enough.

    If objects sweep too much of the frame, they are inpainted at either's motions in turn, and the log-likelihood
    ratios are added. The candidate must use as many frames; if motions are the same, more frames, well explained.

    Args:
        estimate: motions that would be replaced.
        candidate: motions that would replace them.
        frames: `(N, H, W)`, as they are.
        mask: `(N, H, W)` bool, samples of moving objects.
    """
    weight = estimate.weight
    common = estimate.used & candidate.used
    n_before, n_after = int(estimate.used.sum()), int(candidate.used.sum())
    if n_after >= n_before and common.sum() > 2:
        motions = [relative(each.motion[common[each.used]]) for each in (estimate, candidate)]
        seen, covered = frames[common], mask[common]
        swept = covered.any(0)
        if swept.float().mean() < 3 / 8:  # of the frame; the objects are left out
            versions = [likelihood_frames(seen, weight * ~swept)]
        else:
            inpainted = [inpaint_background(seen, covered, weight, each) for each in motions]
            versions = [likelihood_frames(each, weight) for each in inpainted]
        reduced, factor = versions[0]
        before, after = (change_pixel_size(each, factor) for each in motions)
        if factor * corner_distance(before, after, reduced) > DISTINCT_DISTANCE:
            block_ratios = [block_log_ratios(each, before, after, GRID_2X2) for each, _ in versions]
            if not accept_by_blocks([sum(block) for block in zip(*block_ratios, strict=True)]):
                return False
            level = search_level(inpaint_mean(estimate.preprocessed, mask, weight), weight).subset(common)
            before, after, rest = *motions, identity(len(motions[0]))
            # Blocks of frames that rotate or stretch do not shift, whatever the motion: their likelihood says little.
            if has_linear_part(before, weight):
                return accept_by_misfit(level, after, before, max_ratio=0.95)
            return accept_by_misfit(level, after, before) or accept_by_misfit(level, after, rest, max_ratio=0.7)
    return n_after > n_before and is_well_explained(candidate)


def refine_inpainted(estimate: MotionEstimate, burst: MotionEstimate, mask: Tensor) -> MotionEstimate:
    """Inpaint masked samples of a burst's frames by the background at the estimated motions, and refine these.

    The frames are those of the estimate `burst`, as they are; the mask is `(N, H, W)` bool.
    """
    weight, motion = burst.weight, identity(len(burst.frames))
    motion[estimate.used] = estimate.motion
    given = burst.frames, burst.preprocessed
    frames, preprocessed = (inpaint_background(each, mask, weight, motion) for each in given)
    level = search_level(preprocessed, weight)
    alignment = Alignment(estimate.motion, *estimate_pattern(level.subset(estimate.used), estimate.motion))
    return refine(replace(estimate, frames=frames, preprocessed=preprocessed, coarse_level=level, alignment=alignment))
