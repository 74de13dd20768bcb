"""Places of frames through which somebody walks: he registers, too, and often better than a plain scene does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from deepir.registration.align import Aligned, standing
from deepir.registration.consensus import PLAIN, costs, prefers
from deepir.registration.likelihood import likeliest_shifts
from deepir.registration.motion import identity, relative
from deepir.registration.place import Placed, search_level, searched, settled, turning
from deepir.registration.repair import repaired
from deepir.registration.vote import FAR, apart, reduced
from deepir.registration.walker import blanked, filled, someone
from deepir.registration.whole import whole_shifts

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
        if lost or costs(level, every(one)) > PLAIN:
            for other in others(one, frames, stands, weight, model):
                motion = repaired(level, every(other), "shift" if model == "shift" else "rigid")
                if prefers(level, every(one), motion):
                    other = at(other, motion)
                    one = without(other, frames, flat, stands, weight, model)
    return one if holes is None else without(one, frames, flat, holes, weight, model)


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
    motion[1:, :2, 2] = factor * torch.from_numpy(likeliest_shifts(seen, whole_shifts(seen)))
    if model != "rigid":
        return motion
    turned = turning(frames, weight, motion)
    return turned if apart(motion, turned, frames) > FAR else motion


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
