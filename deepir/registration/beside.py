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
from deepir.registration.place import Placed, misfit, place, search_level, settled, turning
from deepir.registration.pyramid import Level
from deepir.registration.vote import FAR, apart, reduced, scaled, turns
from deepir.registration.walker import blanked, filled, someone
from deepir.registration.whole import whole_shifts

WELL = 0.2  # of what no motion leaves unexplained where he is filled in: a motion that leaves less is right
NOTHING = 0.7  # of that: a motion that leaves more explains nothing
CLEARLY = 0.95  # of what a motion leaves that turns: another that leaves less is better
PASSED = 3 / 8  # share of the frame where somebody passes, up to which the rest says enough


def beside_walker(one: Placed, weight: Tensor, model: str) -> Placed:
    """Frames that are placed once more without whoever walks through them, if their parts like that better.

    weight: `(H, W)`, zero where a pixel is bad.
    """
    if len(one.frames) < 3 or not (stands := someone(one.flat)).any():
        return one
    frames, flat = torch.where(weight > 0, one.frames.float(), 0.0), one.flat
    level = search_level(blanked(flat, stands, weight), weight)
    if misfit(level.of(one.used), one.motion) < WELL * misfit(level.of(one.used), identity(len(one.motion))):
        return one
    for other in others(one, frames, stands, weight, model):
        if better(one, other, level, frames, stands, weight):
            one = without(other, frames, flat, stands, weight, model)
    return one


def others(one: Placed, frames: Tensor, stands: Tensor, weight: Tensor, model: str) -> Iterator[Placed]:
    """Where else frames `(N, H, W)` may be: as if he were not there; and by their likelihood beside his way."""
    used = one.used
    seen, flat = (blanked(each, stands, weight) for each in (frames, one.flat))
    yield place(seen, flat, weight, model)
    passed = stands[used].any(0)
    if used.sum() > 2 and passed.float().mean() < PASSED:
        beside = weight * ~passed
        seen, factor = reduced(frames[used], beside)
        moved = identity(len(seen))
        moved[1:, :2, 2] = factor * torch.from_numpy(likeliest_shifts(seen, whole_shifts(seen)))
        if model == "rigid":
            turned = turning(frames[used], beside, moved)
            moved = turned if apart(moved, turned, frames) > FAR else moved
        yield replace(one, motion=moved)


def better(one: Placed, other: Placed, level: Level, frames: Tensor, stands: Tensor, weight: Tensor) -> bool:
    """Whether frames `(N, H, W)` are likelier at the motions of `other`; if these are the same, whether it has more.

    Beside his way, if that is enough. Else he is filled in, by either's motions in turn, for which that speaks.
    level: frames in which he is filled in as if nothing moved; motions that explain no more of them are none.
    """
    both = one.used & other.used
    if both.sum() > 2:
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
    return bool(other.used.sum() > one.used.sum())


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
