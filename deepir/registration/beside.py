"""Places of frames through which somebody walks: he registers, too, and often better than a plain scene does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from deepir.registration.align import Aligned, standing
from deepir.registration.likelihood import likeliest_shifts
from deepir.registration.motion import identity, relative
from deepir.registration.parts import FOUR, all_but_one, gains
from deepir.registration.place import Placed, fine, misfit, search_level, searched, settled, turning
from deepir.registration.pyramid import Level
from deepir.registration.vote import FAR, apart, reduced, scaled, turns
from deepir.registration.walker import blanked, filled, someone
from deepir.registration.whole import whole_shifts

WELL = 0.2  # of what no motion leaves unexplained where he is filled in: a motion that leaves less is right
WHOLE = 0.08  # the same of the frames as they are, on the finest level: of a scene or of him, not of both
WORSE = 3.7  # times what is left of the frames as they are: what leaves more is no better, whoever walks
NOTHING = 0.7  # of that: a motion that leaves more explains nothing
CLEARLY = 0.95  # of what a motion leaves that turns: another that leaves less is better
ENOUGH = 0.4  # of the frame beside his way, to be searched in
PASSED = 3 / 8  # share of the frame where somebody passes, up to which the rest says enough


def beside_walker(one: Placed, weight: Tensor, model: str, holes: Tensor | None = None) -> Placed:
    """Frames that are placed once more without whoever walks through them, if their parts like that better.

    weight: `(H, W)`, zero where a pixel is bad. holes: `(N, H, W)` bool, samples that nothing is known of, as if
    somebody stood there; in the end what the other frames show is filled in.
    """
    stands = someone(one.flat) if len(one.frames) > 2 else torch.zeros(one.flat.shape, dtype=torch.bool)
    stands = stands if holes is None else stands | holes
    frames, flat = torch.where(weight > 0, one.frames.float(), 0.0), one.flat
    if len(frames) > 2 and stands.any():
        level = search_level(blanked(flat, stands, weight), weight)
        lost = holes is not None and not one.used.all()
        if lost or not (well(one, level, WELL) or well(one, finest(one, weight), WHOLE)):
            whole = finest(one, weight)
            for other in others(one, frames, stands, weight, model):
                if better(one, other, level, frames, stands, weight) and not far_worse(one, other, whole):
                    one = without(other, frames, flat, stands, weight, model)
    return one if holes is None else without(one, frames, flat, holes, weight, model)


def well(one: Placed, level: Level, share: float) -> bool:
    """Whether its motions leave less than a share of what no motion leaves of a level's frames."""
    left, none = (misfit(level.of(one.used), each) for each in (one.motion, identity(len(one.motion))))
    return left < share * none


def far_worse(one: Placed, other: Placed, level: Level) -> bool:
    """Whether other motions leave far more of a level's frames, of those that both use."""
    both = one.used & other.used
    had, has = (misfit(level.of(both), each.motion[both[each.used]]) for each in (one, other))
    return has > WORSE * had


def finest(one: Placed, weight: Tensor) -> Level:
    """The level on which motions are refined last: there, what moves by a few px differs."""
    return fine(one.flat, weight, one.coarse.factor)[-1]


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
    motion[1:, :2, 2] = factor * torch.from_numpy(likeliest_shifts(seen, whole_shifts(seen)))
    if model != "rigid":
        return motion
    turned = turning(frames, weight, motion)
    return turned if apart(motion, turned, frames) > FAR else motion


def better(one: Placed, other: Placed, level: Level, frames: Tensor, stands: Tensor, weight: Tensor) -> bool:
    """Whether frames `(N, H, W)` are likelier at the motions of `other`; if these are the same, whether it has more.

    Beside his way, if that is enough. Else he is filled in, by either's motions in turn, for which that speaks. None
    is better that is of fewer frames.
    level: frames in which he is filled in as if nothing moved; motions that explain no more of them are none.
    """
    both, had_frames, has_frames = one.used & other.used, int(one.used.sum()), int(other.used.sum())
    if has_frames >= had_frames and both.sum() > 2:
        places = [relative(each.motion[both[each.used]]) for each in (one, other)]
        none, had, has = (misfit(level.of(both), each) for each in (identity(int(both.sum())), *places))
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
    return has_frames > had_frames


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
