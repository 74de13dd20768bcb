"""Frames of a closed shutter, which show the fixed pattern and nothing else."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alternating_alignment import estimate_pattern
from deepir.registration.cross_correlation import correlation_search
from deepir.registration.frame_groups import reject_frames
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
    distance = torch.cdist(images, images).square()
    typical = distance[~torch.eye(len(images), dtype=torch.bool)].median()
    least_spread, scene_frames = EVENLY, none
    for distances in distance:
        different = distances > SAME * typical
        if (
            different.sum() >= FEWEST
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
    is_static = alignment.pattern.square().mean() > STANDS * difference.frames.square().mean()
    return (
        ~scene_frames
        if used.float().mean() > MOST and alignment.misfit < LEFT * misfit_at_rest and not is_static
        else none
    )
