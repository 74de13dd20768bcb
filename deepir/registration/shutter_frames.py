"""Frames of a closed shutter, which show the fixed pattern and nothing else."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from deepir.operators.motion_models import identity
from deepir.registration.alternating_alignment import estimate_pattern
from deepir.registration.cross_correlation import correlation_search
from deepir.registration.frame_groups import reject_frames
from deepir.registration.pyramid import Level


@dataclass(frozen=True)
class ShutterCriteria:
    """When frames show a closed shutter: the fixed pattern only."""

    min_scene_frames: int = 3
    max_spread: float = (
        1.35  # largest over smallest squared distance to scene frames; of a scene frame it is larger
    )
    duplicate_distance: float = 0.1  # of the median squared distance; closer frames are equal up to noise
    max_static_power: float = (
        0.06  # of the mean square of scene minus shutter frames, which static structure may have
    )
    max_misfit_ratio: float = 0.1  # misfit of scene minus shutter frames at their motions, over that at rest
    min_consistent: float = 0.7  # share of the scene frames that must show one scene


SHUTTER = ShutterCriteria()


def shutter_frames(level: Level, model: str) -> Tensor:
    """Which frames `(N,)` of a level show no scene.

    All others are equally far from such a frame, by as much as they show of the scene, and less it, they show a scene
    that moves and nothing that stands still. Less a frame that shows the scene, too, they show this, still.
    """
    images = level.frames.flatten(1)
    none = torch.zeros(len(images), dtype=torch.bool)
    distance = torch.cdist(images, images).square()
    typical = distance[~torch.eye(len(images), dtype=torch.bool)].median()
    least_spread, scene_frames = SHUTTER.max_spread, none
    for distances in distance:
        different = distances > SHUTTER.duplicate_distance * typical
        if (
            different.sum() >= SHUTTER.min_scene_frames
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
    is_static = (
        alignment.pattern.square().mean() > SHUTTER.max_static_power * difference.frames.square().mean()
    )
    return (
        ~scene_frames
        if used.float().mean() > SHUTTER.min_consistent
        and alignment.misfit < SHUTTER.max_misfit_ratio * misfit_at_rest
        and not is_static
        else none
    )
