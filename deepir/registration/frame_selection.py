"""Which frames of a burst show one scene, and a first motion for each: on the level of the search.

First motions of a camera that pans: each frame by one that sees much of the same.

Frames of a closed shutter, which show the fixed pattern and nothing else."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alignment import Alignment, align, estimate_pattern, tukey_weights, warp_to_reference
from deepir.registration.cross_correlation import correlation_search, match_to_reference
from deepir.registration.pyramid import Level

MIN_CONCORDANCE = 0.6  # frames below it are rejected; aligned frames of other scenes reach 0.5
MIN_OVERLAP = 0.15  # of the frame, that other frames must show
CLEAR_MISFIT_RATIO = 1.5  # ratio of misfits per degree of freedom from which the lower one is clearly lower
SELECTION_ROUNDS = 3  # Gauss-Newton rounds of an alignment before frames are rejected
PAN_SHIFT = 0.2  # of the frame; larger shifts are those of a pan
MAX_PAN_ROUNDS = 3  # spanning trees, each with the pattern of the one before


@dataclass(frozen=True)
class RestCriteria:
    """When frames do not move: the misfit at rest, over that at the estimated motions, is below a ratio.

    Misfits are per degree of freedom. Few frames share a scene point after large motions, which explains any frames
    well: the ratio is larger then.
    """

    max_ratio: float = 1.3
    far_shift: float = 0.3  # of the frame; larger shifts are large motions
    max_ratio_if_far: float = 4.0


REST = RestCriteria()

CERTAIN_SCORE = 3.0  # match score from which a frame is not searched in further frames


@dataclass(frozen=True)
class ShutterCriteria:
    """When frames show a closed shutter: the fixed pattern only."""

    min_scene_frames: int = 3
    max_spread: float = (
        1.35  # largest over smallest squared distance to scene frames; of a scene frame it is larger
    )
    duplicate_distance: float = 0.1  # of the median squared distance; closer frames are equal up to noise
    max_static_power: float = (
        0.06  # of the mean square of scene minus shutter frames, which static structure may have
    )
    max_misfit_ratio: float = 0.1  # misfit of scene minus shutter frames at their motions, over that at rest
    min_consistent: float = 0.7  # share of the scene frames that must show one scene


SHUTTER = ShutterCriteria()


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
    """How clearly `(N,)` frames show the scene that most of them show, which ones `(N,)` do, and their motions.

    The middle of all frames holds the whole pattern, however strong. Frames less it still match where the scene
    does, if there are three or more and they move; other bursts are searched as they are. In a strong pattern that
    may lock onto what stands still, but then it leaves more unexplained.
    """
    best = None
    for pattern_present in (True, False) if len(level.frames) > 2 else (True,):
        images = level.frames if pattern_present else level.frames - level.frames.median(0).values
        motion, match_score = correlation_search(images, level, model, pattern_present)
        used, alignment = reject_frames(level, match_score > 1, motion, model)
        if best is None or CLEAR_MISFIT_RATIO * misfit_per_dof(alignment) < misfit_per_dof(best.alignment):
            best = FrameSelection(match_score, used, alignment)
    assert best is not None
    match_score, used, alignment = best.match_score, best.used, best.alignment
    if used.sum() > 2 and exceeds_shift(level, alignment.motion, PAN_SHIFT):
        return register_pan(level, best, model)
    if 1 < used.sum() < len(used):  # the mean of these frames sees more of the scene than one of them
        scene = warp_to_reference(level.subset(used), alignment.pattern, alignment.motion).mean
        motion, new_score = match_to_reference(
            scene, level.frames - alignment.pattern, level, model, pattern_present=False
        )
        motion[used], match_score = alignment.motion, new_score
        extended = used | (match_score > 1)
        if not torch.equal(extended, used):
            used, alignment = reject_frames(level, extended, motion, model)
    return FrameSelection(match_score, used, alignment)


def register_pan(level: Level, selection: FrameSelection, model: str) -> FrameSelection:
    """The same of frames that are far from each other, each looked for in those that see much of what it sees.

    Correlations know shifts up to half a frame only, and take one that is longer for another.
    """
    n = len(level.frames)
    known = torch.arange(n) == int(selection.match_score.argmax())
    motion, pattern = identity(n), level.frames.median(0).values
    for _ in range(MAX_PAN_ROUNDS):
        motion, new_score = spanning_tree_motions(level.frames - pattern, level, model, motion, known)
        new_used, new_alignment = reject_frames(level, new_score > 1, motion, model)
        before, after = misfit_per_dof(selection.alignment), misfit_per_dof(new_alignment)
        worse = new_used.sum() < selection.used.sum() or after > CLEAR_MISFIT_RATIO * before
        if worse and not CLEAR_MISFIT_RATIO * after < before:
            break
        grown = bool((new_used & ~known).any())
        selection = FrameSelection(new_score, new_used, new_alignment)
        known, pattern, motion[new_used] = new_used, new_alignment.pattern, new_alignment.motion
        if not grown or new_used.all():
            break
    return selection


def exceeds_shift(level: Level, motion: Tensor, share: float) -> bool:
    """Whether a motion `(N, 3, 3)` shifts by more than a share of the frame."""
    return bool((motion[:, :2, 2].abs() > share * torch.tensor(level.shape[::-1])).any())


def reject_frames(level: Level, used: Tensor, motion: Tensor, model: str) -> tuple[Tensor, Alignment]:
    """Those `(N,)` of the frames used that agree once they are aligned, and their motions.

    A frame that does not belong is in the others' scene and pattern, too: so the worst goes first, by itself.
    """
    used = used.clone()
    while True:
        alignment = align(level.subset(used), motion[used], model, SELECTION_ROUNDS)
        concordances = concordance(level.subset(used), alignment.pattern, alignment.motion)
        if len(concordances) < 3 or concordances.min() >= MIN_CONCORDANCE:
            return used, alignment
        used[used.nonzero()[concordances.argmin()]] = False


def misfit_per_dof(alignment: Alignment) -> float:
    """What is left unexplained for each degree of freedom: n frames have n - 2 beside pattern and scene."""
    n = len(alignment.motion)
    return alignment.misfit / (n - 2) if n > 2 else math.inf


def frames_at_rest(level: Level, alignment: Alignment) -> Tensor:
    """Frames `(N,)` that are the same but for noise; none, if the motions that were found explain more than that."""
    unchanged = (
        concordance(level, torch.zeros_like(level.weight), identity(len(level.frames))) >= MIN_CONCORDANCE
    )
    frames = level.frames[unchanged]
    if len(frames) < 3:
        return torch.zeros_like(unchanged)
    change = float((frames - frames.mean(0)).square().mean() / frames.square().mean().clamp_min(1e-12))
    ratio = (
        REST.max_ratio_if_far if exceeds_shift(level, alignment.motion, REST.far_shift) else REST.max_ratio
    )
    return unchanged & (change / (len(frames) - 1) < ratio * misfit_per_dof(alignment))


def concordance(level: Level, pattern: Tensor, motion: Tensor) -> Tensor:
    """Concordance `(N,)` (Lin 1989) of each frame, less the pattern, with the mean of all others.

    Unlike a correlation it is low, too, for a frame in which there is no scene and next to nothing is left. Under
    Tukey's weights, things that move by themselves do not count.
    """
    warped = warp_to_reference(level, pattern, motion)
    expected, known = warped.leave_one_out_mean()
    observed, expected, known = (image.flatten(1) for image in (warped.frames, expected, known))
    weight = tukey_weights(observed - expected, known)
    power = (weight * (expected.square() + observed.square())).sum(1).clamp_min(1e-12)
    overlapping = known.mean(1) > MIN_OVERLAP
    return (2 * (weight * expected * observed).sum(1) / power * overlapping).double()


def spanning_tree_motions(
    images: Tensor, level: Level, model: str, motion: Tensor, known: Tensor
) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of images `(N, h, w)` that hold no pattern, and how clear `(N,)` the new ones are.

    From those that are `known`, `(N,)` bool, of which others are looked for in each. The clearest comes next, and is
    looked in, too: a spanning tree of the clearest matches (Prim 1957). Frames that see different places match by
    chance as well as those that see a strip of the same, but never as those that see most of it.
    """
    motion, match_score = motion.clone(), torch.where(known, torch.inf, 0.0).double()
    unvisited = torch.ones_like(known)
    while True:
        k = int(torch.where(unvisited, match_score, -1.0).argmax())
        unvisited[k] = False
        weak = (unvisited & (match_score < CERTAIN_SCORE)).nonzero()[:, 0]
        if not match_score[k] > 1 or not len(weak):
            return motion, match_score
        relative_motion, new_score = match_to_reference(
            images[k], images[weak], level, model, pattern_present=False
        )
        improved = new_score > match_score[weak]
        updated = weak[improved]
        motion[updated], match_score[updated] = motion[k] @ relative_motion[improved], new_score[improved]


def shutter_frames(level: Level, model: str) -> Tensor:
    """Which frames `(N,)` of a level show no scene.

    All others are equally far from such a frame, by as much as they show of the scene, and less it, they show a scene
    that moves and nothing that stands still. Less a frame that shows the scene, too, they show this, still.
    """
    images = level.frames.flatten(1)
    none = torch.zeros(len(images), dtype=torch.bool)
    distance = torch.cdist(images, images).square()
    typical = distance[~torch.eye(len(images), dtype=torch.bool)].median()
    least_spread, scene_frames = SHUTTER.max_spread, none
    for distances in distance:
        different = distances > SHUTTER.duplicate_distance * typical
        if (
            different.sum() >= SHUTTER.min_scene_frames
            and (spread := float(distances[different].max() / distances[different].min())) < least_spread
        ):
            least_spread, scene_frames = spread, different
    if not scene_frames.any():
        return none
    shutter = (~scene_frames).nonzero()[:, 0]
    difference = replace(level, frames=level.frames[scene_frames] - level.frames[shutter].mean(0))
    motion, match_score = correlation_search(difference.frames, difference, model, pattern_present=False)
    used, alignment = reject_frames(difference, match_score > 1, motion, model)
    misfit_at_rest = estimate_pattern(difference.subset(used), identity(int(used.sum())))[1]
    is_static = (
        alignment.pattern.square().mean() > SHUTTER.max_static_power * difference.frames.square().mean()
    )
    return (
        ~scene_frames
        if used.float().mean() > SHUTTER.min_consistent
        and alignment.misfit < SHUTTER.max_misfit_ratio * misfit_at_rest
        and not is_static
        else none
    )
