"""Frames of a closed shutter, which show the fixed pattern and nothing else."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alternating_alignment import standing
from deepir.registration.cross_correlation import search
from deepir.registration.frame_groups import consistent
from deepir.registration.pyramid import Level

FEWEST = 3  # other frames
EVENLY = 1.35  # times further from the furthest frame than from the nearest: of a scene, frames are by how they move
SAME = 0.1  # of the usual distance: frames that are the same but for noise
STANDS = 0.06  # of the others less this frame, what may stand still in them
LEFT = 0.1  # of what no motion explains of them, what motions may leave
MOST = 0.7  # of these that have to show one scene


def shutter_frames(level: Level, model: str) -> Tensor:
    """Which frames `(N,)` of a level show no scene.

    All others are equally far from such a frame, by as much as they show of the scene, and less it, they show a scene
    that moves and nothing that stands still. Less a frame that shows the scene, too, they show this, still.
    """
    images = level.frames.flatten(1)
    none = torch.zeros(len(images), dtype=torch.bool)
    far = torch.cdist(images, images).square()
    usual = far[~torch.eye(len(images), dtype=torch.bool)].median()
    best, others = EVENLY, none
    for one in far:
        apart = one > SAME * usual
        if apart.sum() >= FEWEST and (evenly := float(one[apart].max() / one[apart].min())) < best:
            best, others = evenly, apart
    if not others.any():
        return none
    this = (~others).nonzero()[:, 0]
    seen = replace(level, frames=level.frames[others] - level.frames[this].mean(0))
    motion, clear = search(seen.frames, seen, model, standing=False)
    used, found = consistent(seen, clear > 1, motion, model)
    still = standing(seen.of(used), identity(int(used.sum())))[1]
    stands = found.pattern.square().mean() > STANDS * seen.frames.square().mean()
    return ~others if used.float().mean() > MOST and found.misfit < LEFT * still and not stands else none
