"""Which frames of a burst show one scene, and a first motion for each: on the level of the search."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alternating_alignment import Aligned, align
from deepir.registration.cross_correlation import match, search
from deepir.registration.gauss_newton import tukey
from deepir.registration.pyramid import Level
from deepir.registration.spanning_tree import chained
from deepir.registration.warp_back import pull

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


def one_scene(level: Level, model: str) -> tuple[Tensor, Tensor, Aligned]:
    """How clearly `(N,)` frames show the scene that most of them show, which ones `(N,)` do, and their motions.

    The middle of all frames holds the whole pattern, however strong. Frames less it still match where the scene
    does, if there are three or more and they move; other bursts are searched as they are. In a strong pattern that
    may lock onto what stands still, but then it leaves more unexplained.
    """
    best = None
    for standing in (True, False) if len(level.frames) > 2 else (True,):
        images = level.frames if standing else level.frames - level.frames.median(0).values
        motion, clear = search(images, level, model, standing)
        used, found = consistent(level, clear > 1, motion, model)
        if best is None or CLEARLY * left(found) < left(best[2]):
            best = clear, used, found
    assert best is not None
    clear, used, found = best
    if used.sum() > 2 and is_far(level, found.motion, PANNED):
        return panned(level, clear, used, found, model)
    if 1 < used.sum() < len(used):  # the mean of these frames sees more of the scene than one of them
        picture = pull(level.of(used), found.pattern, found.motion).mean
        motion, again = match(picture, level.frames - found.pattern, level, model, standing=False)
        motion[used], clear = found.motion, again
        more = used | (clear > 1)
        if not torch.equal(more, used):
            used, found = consistent(level, more, motion, model)
    return clear, used, found


def panned(
    level: Level, clear: Tensor, used: Tensor, found: Aligned, model: str
) -> tuple[Tensor, Tensor, Aligned]:
    """The same of frames that are far from each other, each looked for in those that see much of what it sees.

    Correlations know shifts up to half a frame only, and take one that is longer for another.
    """
    known = torch.arange(len(clear)) == int(clear.argmax())
    motion, pattern = identity(len(clear)), level.frames.median(0).values
    for _ in range(PANS):
        motion, again = chained(level.frames - pattern, level, model, motion, known)
        more, better = consistent(level, again > 1, motion, model)
        worse = more.sum() < used.sum() or left(better) > CLEARLY * left(found)
        if worse and not CLEARLY * left(better) < left(found):
            break
        grown = bool((more & ~known).any())
        clear, used, found = again, more, better
        known, pattern, motion[used] = used, found.pattern, found.motion
        if not grown or used.all():
            break
    return clear, used, found


def is_far(level: Level, motion: Tensor, share: float) -> bool:
    """Whether a motion `(N, 3, 3)` shifts by more than a share of the frame."""
    return bool((motion[:, :2, 2].abs() > share * torch.tensor(level.shape[::-1])).any())


def consistent(level: Level, used: Tensor, motion: Tensor, model: str) -> tuple[Tensor, Aligned]:
    """Those `(N,)` of the frames used that agree once they are aligned, and their motions.

    A frame that does not belong is in the others' scene and pattern, too: so the worst goes first, by itself.
    """
    used = used.clone()
    while True:
        found = align(level.of(used), motion[used], model, ROUGH)
        agree = agreement(level.of(used), found.pattern, found.motion)
        if len(agree) < 3 or agree.min() >= FAILED:
            return used, found
        used[used.nonzero()[agree.argmin()]] = False


def left(found: Aligned) -> float:
    """What is left unexplained for each degree of freedom: n frames have n - 2 beside pattern and scene."""
    n = len(found.motion)
    return found.misfit / (n - 2) if n > 2 else math.inf


def at_rest(level: Level, found: Aligned) -> Tensor:
    """Frames `(N,)` that are the same but for noise; none, if the motions that were found explain more than that."""
    same = agreement(level, torch.zeros_like(level.weight), identity(len(level.frames))) >= FAILED
    frames = level.frames[same]
    if len(frames) < 3:
        return torch.zeros_like(same)
    change = float((frames - frames.mean(0)).square().mean() / frames.square().mean().clamp_min(1e-12))
    times = SAME_IF_FAR if is_far(level, found.motion, FAR) else SAME
    return same & (change / (len(frames) - 1) < times * left(found))


def agreement(level: Level, pattern: Tensor, motion: Tensor) -> Tensor:
    """Concordance `(N,)` (Lin 1989) of each frame, less the pattern, with the mean of all others.

    Unlike a correlation it is low, too, for a frame in which there is no scene and next to nothing is left. Under
    Tukey's weights, things that move by themselves do not count.
    """
    pulled = pull(level, pattern, motion)
    expected, known = pulled.others()
    seen, expected, known = (image.flatten(1) for image in (pulled.frames, expected, known))
    weight = tukey(seen - expected, known)
    power = (weight * (expected.square() + seen.square())).sum(1).clamp_min(1e-12)
    enough = known.mean(1) > OVERLAP
    return (2 * (weight * expected * seen).sum(1) / power * enough).double()
