"""Which frames of a burst show one scene, and a first motion for each: on the level of the search."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alternating_alignment import Alignment, align
from deepir.registration.cross_correlation import correlation_search, match_to_reference
from deepir.registration.gauss_newton import tukey_weights
from deepir.registration.pyramid import Level
from deepir.registration.spanning_tree import spanning_tree_motions
from deepir.registration.warp_back import warp_to_reference

FAILED = 0.6  # agreement below which a frame is left out: other scenes reach 0.5, once aligned
OVERLAP = 0.15  # share of the frame that must see what others see
CLEARLY = 1.5  # times more unexplained: a worse motion
SAME = 1.3  # times what is left with motions, for each degree of freedom: frames that do not move
#: Motions by more than this share of the frame explain frames that do not move, too, down to so many times less: what
#: few frames see is easily explained.
FAR, SAME_IF_FAR = 0.3, 4.0
ROUGH = 3  # rounds of alignment
#: Share of the frame from which a camera pans, and times that frames are looked for in those found before.
PANNED, PANS = 0.2, 3


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
        if best is None or CLEARLY * misfit_per_dof(alignment) < misfit_per_dof(best.alignment):
            best = FrameSelection(match_score, used, alignment)
    assert best is not None
    match_score, used, alignment = best.match_score, best.used, best.alignment
    if used.sum() > 2 and exceeds_shift(level, alignment.motion, PANNED):
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
    for _ in range(PANS):
        motion, new_score = spanning_tree_motions(level.frames - pattern, level, model, motion, known)
        new_used, new_alignment = reject_frames(level, new_score > 1, motion, model)
        before, after = misfit_per_dof(selection.alignment), misfit_per_dof(new_alignment)
        worse = new_used.sum() < selection.used.sum() or after > CLEARLY * before
        if worse and not CLEARLY * after < before:
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
        alignment = align(level.subset(used), motion[used], model, ROUGH)
        concordances = concordance(level.subset(used), alignment.pattern, alignment.motion)
        if len(concordances) < 3 or concordances.min() >= FAILED:
            return used, alignment
        used[used.nonzero()[concordances.argmin()]] = False


def misfit_per_dof(alignment: Alignment) -> float:
    """What is left unexplained for each degree of freedom: n frames have n - 2 beside pattern and scene."""
    n = len(alignment.motion)
    return alignment.misfit / (n - 2) if n > 2 else math.inf


def frames_at_rest(level: Level, alignment: Alignment) -> Tensor:
    """Frames `(N,)` that are the same but for noise; none, if the motions that were found explain more than that."""
    unchanged = concordance(level, torch.zeros_like(level.weight), identity(len(level.frames))) >= FAILED
    frames = level.frames[unchanged]
    if len(frames) < 3:
        return torch.zeros_like(unchanged)
    change = float((frames - frames.mean(0)).square().mean() / frames.square().mean().clamp_min(1e-12))
    ratio = SAME_IF_FAR if exceeds_shift(level, alignment.motion, FAR) else SAME
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
    overlapping = known.mean(1) > OVERLAP
    return (2 * (weight * expected * observed).sum(1) / power * overlapping).double()
