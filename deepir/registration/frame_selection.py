"""Which frames show one scene, and an initial motion for each, on the level of the coarse search.

`largest_consistent_set` matches all frames to one reference and rejects those that disagree once aligned
(`reject_frames`); frames of a pan are matched along a spanning tree (`register_pan`). `shutter_frames` finds frames
without a scene, `frames_at_rest` frames that do not move.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alignment import Alignment, align, estimate_pattern, tukey_weights, warp_to_reference
from deepir.registration.preprocess import Level
from deepir.registration.shift_likelihood import correlation_search, match_to_reference

MIN_CONCORDANCE = 0.6  # frames below it are rejected; aligned frames of other scenes reach 0.5
MIN_OVERLAP = 0.15  # of the frame, that other frames must show
CLEAR_MISFIT_RATIO = 1.5  # ratio of misfits per degree of freedom at which the lower one is clearly lower
REJECTED_SHARE = 1 / 32  # of many frames, that are rejected at a time
SELECTION_ROUNDS = 3  # Gauss-Newton rounds of an alignment before frames are rejected
PAN_SHIFT = 0.2  # of the frame; larger shifts are those of a pan
MIN_SCENE_FRAMES = 3  # beside which frames of a closed shutter are found


@dataclass(frozen=True)
class FrameSelection:
    """The frames that show one scene.

    match_score: `(N,)`, height of each frame's correlation peak over the detection threshold. used: `(N,)` bool.
    alignment: of the frames used.
    """

    match_score: Tensor
    used: Tensor
    alignment: Alignment


def largest_consistent_set(level: Level, model: str) -> FrameSelection:
    """Find the frames that show the scene that most of them show, and their motions.

    Two searches compete by misfit: of the frames as they are, and of three or more frames less their temporal median.
    The median contains the whole pattern, but also a scene that does not move; a strong pattern misleads the first.
    Then rejected frames are searched once more in the mean of the others. The model is "shift" or "rigid".
    """
    found = []
    for pattern_present in (True, False) if len(level.frames) > 2 else (True,):
        images = level.frames if pattern_present else level.frames - level.frames.median(0).values
        motion, match_score = correlation_search(images, level, model, pattern_present)
        found.append(FrameSelection(match_score, *reject_frames(level, match_score > 1, motion, model)))
    best = found[-1] if has_clearly_lower_misfit(found[-1].alignment, found[0].alignment) else found[0]
    used, alignment = best.used, best.alignment
    if used.sum() > 2 and exceeds_shift(level, alignment.motion, PAN_SHIFT):
        return register_pan(level, best, model)
    if not 1 < used.sum() < len(used):
        return best
    scene = warp_to_reference(level.subset(used), alignment.pattern, alignment.motion).mean
    images = level.frames - alignment.pattern
    motion, match_score = match_to_reference(scene, images, level, model, pattern_present=False)
    motion[used] = alignment.motion
    extended = used | (match_score > 1)
    if not torch.equal(extended, used):
        used, alignment = reject_frames(level, extended, motion, model)
    return FrameSelection(match_score, used, alignment)


def register_pan(level: Level, selection: FrameSelection, model: str) -> FrameSelection:
    """Register a panning camera along spanning trees, as long as more frames are found or the misfit is lower.

    A correlation is unambiguous for shifts up to half a frame only. So each frame is matched to one that shows much of
    what it shows. The selection is that found by matching all frames to one; the model is "shift" or "rigid".
    """
    n = len(level.frames)
    known = torch.arange(n) == int(selection.match_score.argmax())
    motion, pattern = identity(n), level.frames.median(0).values
    for _ in range(3):  # trees at most, each with the pattern of the one before
        motion, match_score = spanning_tree_motions(level.frames - pattern, level, model, motion, known)
        used, alignment = reject_frames(level, match_score > 1, motion, model)
        is_worse = used.sum() < selection.used.sum() or has_clearly_lower_misfit(selection.alignment, alignment)
        if is_worse and not has_clearly_lower_misfit(alignment, selection.alignment):
            break
        has_grown = bool((used & ~known).any())
        selection = FrameSelection(match_score, used, alignment)
        known, pattern, motion[used] = used, alignment.pattern, alignment.motion
        if not has_grown or used.all():
            break
    return selection


def spanning_tree_motions(
    images: Tensor, level: Level, model: str, motion: Tensor, known: Tensor
) -> tuple[Tensor, Tensor]:
    """Match images along the spanning tree of the best matches, from those whose motions are known.

    The image with the best match is visited next, and all uncertain images are searched in it. Images that share only
    a strip match no better than those that share nothing; those that share most of the frame match best.

    Args:
        images: `(N, h, w)`, without the pattern.
        level: their level.
        model: "shift" or "rigid".
        motion: `(N, 3, 3)`; NaN where unknown, and then not used.
        known: `(N,)` bool.

    Returns:
        Motions `(N, 3, 3)` and match scores `(N,)`, infinite where known.

    Source: Prim, Shortest connection networks, Bell System Technical Journal 36 (1957).
    """
    motion, match_score = motion.clone(), torch.where(known, torch.inf, 0.0).double()
    unvisited = torch.ones_like(known)
    while True:
        k = int(torch.where(unvisited, match_score, -1.0).argmax())
        unvisited[k] = False
        uncertain = (unvisited & (match_score < 3)).nonzero()[:, 0]  # others are not searched in further images
        if not match_score[k] > 1 or not len(uncertain):
            return motion, match_score
        step, score = match_to_reference(images[k], images[uncertain], level, model, pattern_present=False)
        improved = score > match_score[uncertain]
        updated = uncertain[improved]
        motion[updated], match_score[updated] = motion[k] @ step[improved], score[improved]


def reject_frames(level: Level, used: Tensor, motion: Tensor, model: str) -> tuple[Tensor, Alignment]:
    """Align frames and reject the one of least concordance, repeatedly, until all of them agree.

    One at a time, since a frame of another scene disturbs scene and pattern of the others, too; of many frames a
    `REJECTED_SHARE`, which bounds the work. From the frames `used`, `(N,)` bool, and their initial motions `(N, 3, 3)`.
    Returns the frames that are left, and their alignment.
    """
    used = used.clone()
    while True:
        alignment = align(level.subset(used), motion[used], model, SELECTION_ROUNDS)
        agreement = concordance(level.subset(used), alignment.pattern, alignment.motion)
        if len(agreement) < 3 or agreement.min() >= MIN_CONCORDANCE:
            return used, alignment
        worst = agreement.argsort(stable=True)[: max(1, int(REJECTED_SHARE * len(agreement)))]
        used[used.nonzero()[worst[agreement[worst] < MIN_CONCORDANCE], 0]] = False


def concordance(level: Level, pattern: Tensor, motion: Tensor) -> Tensor:
    """Concordance correlation of each frame, less the pattern, with the mean of the others, under Tukey weights.

    Unlike a correlation it is low for a frame without a scene, too. Objects that move by themselves have little weight.
    Of a pattern `(h, w)` and motions `(N, 3, 3)` it is `(N,)` float64, at most one, and zero for frames that overlap
    too little with the others.

    Source: Lin, A concordance correlation coefficient to evaluate reproducibility, Biometrics 45 (1989).
    """
    warped = warp_to_reference(level, pattern, motion)
    expected, known = warped.leave_one_out_mean()
    observed, expected, known = (image.flatten(1) for image in (warped.frames, expected, known))
    weight = tukey_weights(observed - expected, known)
    power = (weight * (expected.square() + observed.square())).sum(1).clamp_min(1e-12)
    is_overlapping = known.mean(1) > MIN_OVERLAP
    return (2 * (weight * expected * observed).sum(1) / power * is_overlapping).double()


def has_clearly_lower_misfit(alignment: Alignment, reference: Alignment) -> bool:
    """Whether an alignment's misfit per degree of freedom is lower than that of another by `CLEAR_MISFIT_RATIO`."""
    return CLEAR_MISFIT_RATIO * misfit_per_dof(alignment) < misfit_per_dof(reference)


def misfit_per_dof(alignment: Alignment) -> float:
    """Misfit per degree of freedom, n - 2 for n frames: scene and pattern take two. Infinite for two frames."""
    n = len(alignment.motion)
    return alignment.misfit / (n - 2) if n > 2 else math.inf


def exceeds_shift(level: Level, motion: Tensor, fraction: float) -> bool:
    """Whether any motion `(N, 3, 3)` shifts by more than a fraction of the frame's side."""
    return bool((motion[:, :2, 2].abs() > fraction * torch.tensor(level.shape[::-1])).any())


def frames_at_rest(level: Level, alignment: Alignment) -> Tensor:
    """Frames `(N,)` bool that are equal up to noise; none if the alignment explains them better than rest does.

    Their misfit per degree of freedom at rest is below a multiple of that at the motions found. The multiple is larger
    after large shifts, where few frames share a scene point.
    """
    rest = identity(len(level.frames))
    unchanged = concordance(level, torch.zeros_like(level.weight), rest) >= MIN_CONCORDANCE
    frames = level.frames[unchanged]
    if len(frames) < 3:
        return torch.zeros_like(unchanged)
    misfit = float((frames - frames.mean(0)).square().mean() / frames.square().mean().clamp_min(1e-12))
    ratio = 4.0 if exceeds_shift(level, alignment.motion, 0.3) else 1.3  # of misfits; shifts, of the frame
    return unchanged & (misfit / (len(frames) - 1) < ratio * misfit_per_dof(alignment))


def shutter_frames(level: Level, model: str) -> Tensor:
    """Frames `(N,)` bool of a closed shutter, which show the fixed pattern only, by a motion model.

    All scene frames are equally far from such a frame. After its subtraction they show one scene that moves, and
    nothing static; after the subtraction of a scene frame they would show its scene as static.
    """
    images = level.frames.flatten(1)
    none = torch.zeros(len(images), dtype=torch.bool)
    distances = torch.cdist(images, images).square()
    typical = distances[~torch.eye(len(images), dtype=torch.bool)].median()
    least_spread, scene_frames = 1.35, none  # largest over smallest squared distance to the scene frames
    for distance in distances:
        different = distance > 0.1 * typical  # closer frames are equal up to noise
        if different.sum() >= MIN_SCENE_FRAMES:
            spread = float(distance[different].max() / distance[different].min())
            if spread < least_spread:
                least_spread, scene_frames = spread, different
    if not scene_frames.any():
        return none
    shutter = (~scene_frames).nonzero()[:, 0]
    difference = replace(level, frames=level.frames[scene_frames] - level.frames[shutter].mean(0))
    motion, match_score = correlation_search(difference.frames, difference, model, pattern_present=False)
    used, alignment = reject_frames(difference, match_score > 1, motion, model)
    _, misfit_at_rest = estimate_pattern(difference.subset(used), identity(int(used.sum())))
    is_static = alignment.pattern.square().mean() > 0.06 * difference.frames.square().mean()  # share
    is_explained = alignment.misfit < 0.1 * misfit_at_rest
    is_consistent = used.float().mean() > 0.7  # of the scene frames show one scene
    return ~scene_frames if is_consistent and is_explained and not is_static else none
