"""Places of frames through which somebody walks: he registers, too, and often better than a plain scene does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity, relative
from deepir.registration.alternating_alignment import Aligned, standing
from deepir.registration.block_likelihood import FOUR, all_but_one, gains
from deepir.registration.block_vote import FAR, apart, reduced, scaled, turns
from deepir.registration.integer_shifts import integer_shifts
from deepir.registration.motion_search import Placed, fine, misfit, search_level, searched, settled, turning
from deepir.registration.moving_object_masks import blanked, filled, someone
from deepir.registration.reregister_worst import repaired
from deepir.registration.robust_score import cost, log_likelihood_ratio
from deepir.registration.shift_likelihood import likeliest_shifts

#: Nats that each sample costs where most frames show one scene and nothing else; and up to which edges of dark scenes
#: may do it: what no motion leaves is then so many times more, of a scene or of him, not of both.
PLAIN, ROUGH, WHOLE = 0.7, 1.0, 0.08
STILL = 0.5  # px up to which a frame seems to stand still
CLEAR = 0.08  # nats by which each sample is better explained, beyond doubt
DOUBT = 0.25  # and up to which it may be worse, where the likelihood of what is beside him says better
NOTHING = 0.7  # of what no motion leaves where he is filled in: a motion that leaves more explains nothing
CLEARLY = 0.95  # of what a motion leaves that turns: another that leaves less is better
PASSED = 3 / 8  # share of the frame where somebody passes, up to which the rest says enough
ENOUGH = 0.4  # of the frame beside his way, to be searched in


def beside_walker(one: Placed, weight: Tensor, model: str, holes: Tensor | None = None) -> Placed:
    """Frames that are placed once more without whoever walks through them, if that explains more of them.

    weight: `(H, W)`, zero where a pixel is bad. holes: `(N, H, W)` bool, samples that nothing is known of, as if
    somebody stood there; in the end what the other frames show is filled in.
    """
    stands = someone(one.flat) if len(one.frames) > 2 else torch.zeros(one.flat.shape, dtype=torch.bool)
    stands = stands if holes is None else stands | holes
    frames, flat, level = torch.where(weight > 0, one.frames.float(), 0.0), one.flat, one.coarse
    if len(frames) > 2 and stands.any():
        lost = holes is not None and not one.used.all()
        if lost or not well(one, weight):
            for sought in others(one, frames, stands, weight, model):
                other = at(sought, repaired(level, every(sought), model))
                gained = log_likelihood_ratio(level, every(one), every(other))
                if gained > CLEAR or (gained > -DOUBT and better(one, other, frames, stands, weight)):
                    one = without(other, frames, flat, stands, weight, model)
    return one if holes is None else without(one, frames, flat, holes, weight, model)


def well(one: Placed, weight: Tensor) -> bool:
    """Whether its motions explain most of the frames; that, or less of them in samples but in squares next to all.

    Not where all but one seem to stand still: that one may have lost lines on its way, and all follow the pattern.
    """
    shifts = every(one)[one.used][:, :2, 2]
    still = (shifts - shifts.median(0).values).norm(dim=1) < STILL
    if len(shifts) > 3 and still.sum() == len(shifts) - 1:
        return False
    left = cost(one.coarse, every(one))
    if not PLAIN < left < ROUGH:
        return left <= PLAIN
    level = fine(one.flat, weight, one.coarse.factor)[-1].of(
        one.used
    )  # there, what moves by a few px differs
    return misfit(level, one.motion) < WHOLE * misfit(level, identity(len(one.motion)))


def every(placed: Placed) -> Tensor:
    """Its motions `(N, 3, 3)`, NaN where a frame is not used."""
    motion = torch.full((len(placed.used), 3, 3), torch.nan, dtype=torch.float64)
    motion[placed.used] = relative(placed.motion)
    return motion


def at(placed: Placed, motion: Tensor) -> Placed:
    """The same at motions `(N, 3, 3)`, NaN where a frame is not used."""
    used = motion.isfinite().all((1, 2))
    return replace(placed, used=used, motion=relative(motion[used]))


def others(one: Placed, frames: Tensor, stands: Tensor, weight: Tensor, model: str) -> Iterator[Placed]:
    """Where else frames `(N, H, W)` may be: as if he were not there; by what is beside his way, if that is enough.

    Only what the search puts elsewhere is settled there: where it finds the same, he did no harm.
    """
    seen, flat = (blanked(each, stands, weight) for each in (frames, one.flat))
    beside = weight * ~stands.any(0)
    sought = searched(seen, flat, weight, model)
    if any_else := elsewhere(one, sought):
        yield settled(sought, weight, model)
    if beside.mean() > ENOUGH:
        sought = searched(frames, one.flat * (beside > 0), beside, model)
        if elsewhere(one, sought):
            any_else = True
            yield settled(sought, beside, model)
        if any_else and one.used.sum() > 2:
            yield replace(one, motion=likeliest(frames[one.used], beside, model))


def elsewhere(one: Placed, other: Placed) -> bool:
    """Whether others of the frames are used, or these are in other places."""
    if not torch.equal(one.used, other.used):
        return True
    return len(one.motion) > 1 and apart(relative(one.motion), relative(other.motion), one.frames) > FAR


def likeliest(frames: Tensor, weight: Tensor, model: str) -> Tensor:
    """The likeliest motions `(N, 3, 3)` of frames `(N, H, W)`: shifts, or turns where these are others."""
    seen, factor = reduced(frames, weight)
    motion = identity(len(seen))
    motion[1:, :2, 2] = factor * torch.from_numpy(likeliest_shifts(seen, integer_shifts(seen)))
    if model != "rigid":
        return motion
    turned = turning(frames, weight, motion)
    return turned if apart(motion, turned, frames) > FAR else motion


def better(one: Placed, other: Placed, frames: Tensor, stands: Tensor, weight: Tensor) -> bool:
    """Whether frames `(N, H, W)` are likelier at the motions of `other`; if these are the same, whether it has more.

    Beside his way, if that is enough. Else he is filled in, by either's motions in turn, for which that speaks. None
    is better that is of fewer frames, nor of more which it does not explain.
    """
    both, had_frames, has_frames = one.used & other.used, int(one.used.sum()), int(other.used.sum())
    if has_frames >= had_frames and both.sum() > 2:
        places = [relative(each.motion[both[each.used]]) for each in (one, other)]
        level = search_level(blanked(one.flat, stands, weight), weight).of(both)
        none, had, has = (misfit(level, each) for each in (identity(int(both.sum())), *places))
        passed = stands[both].any(0)
        if passed.float().mean() < PASSED:
            seen = [reduced(frames[both], weight * ~passed)]
        else:
            seen = [reduced(filled(frames[both], stands[both], weight, each), weight) for each in places]
        small, factor = seen[0]
        before, after = (scaled(each, factor) for each in places)
        if factor * apart(before, after, small) > FAR:
            gained = [gains(each, before, after, FOUR) for each, _ in seen]
            likelier = all_but_one([sum(part) for part in zip(*gained, strict=True)]) > 0
            # Parts of frames that turn are not like each other, wherever they are put: their vote says little.
            most = CLEARLY * had if turns(places[0], weight) else max(had, NOTHING * none)
            return likelier and has < most
    return has_frames > had_frames and well(other, weight)


def without(
    placed: Placed, frames: Tensor, flat: Tensor, stands: Tensor, weight: Tensor, model: str
) -> Placed:
    """The same, refined where he is filled in by what its motions say of his place."""
    motion = identity(len(frames))
    motion[placed.used] = placed.motion
    frames, flat = (filled(each, stands, weight, motion) for each in (frames, flat))
    coarse = search_level(flat, weight)
    found = Aligned(placed.motion, *standing(coarse.of(placed.used), placed.motion))
    return settled(replace(placed, frames=frames, flat=flat, coarse=coarse, found=found), weight, model)
