"""First motions of a camera that pans: each frame by one that sees much of the same."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.cross_correlation import match
from deepir.registration.pyramid import Level

SURE = 3.0  # how clear a frame is that need not be looked for in others


def chained(images: Tensor, level: Level, model: str, motion: Tensor, known: Tensor) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of images `(N, h, w)` that hold no pattern, and how clear `(N,)` the new ones are.

    From those that are `known`, `(N,)` bool, of which others are looked for in each. The clearest comes next, and is
    looked in, too: a spanning tree of the clearest matches (Prim 1957). Frames that see different places match by
    chance as well as those that see a strip of the same, but never as those that see most of it.
    """
    motion, clear = motion.clone(), torch.where(known, torch.inf, 0.0).double()
    waiting = torch.ones_like(known)
    while True:
        k = int(torch.where(waiting, clear, -1.0).argmax())
        waiting[k] = False
        unsure = (waiting & (clear < SURE)).nonzero()[:, 0]
        if not clear[k] > 1 or not len(unsure):
            return motion, clear
        found, again = match(images[k], images[unsure], level, model, standing=False)
        better = again > clear[unsure]
        which = unsure[better]
        motion[which], clear[which] = motion[k] @ found[better], again[better]
