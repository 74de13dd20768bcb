"""First motions of a camera that pans: each frame by one that sees much of the same."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.cross_correlation import match_to_reference
from deepir.registration.pyramid import Level

CERTAIN_SCORE = 3.0  # match score from which a frame is not searched in further frames


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
