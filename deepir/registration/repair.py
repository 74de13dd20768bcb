"""Frames that are sought once more, each in what all others show."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.consensus import explained, prefers, residuals, unexplained, width
from deepir.registration.pyramid import Level
from deepir.registration.search import match
from deepir.registration.vote import FAR, apart


def repaired(level: Level, motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)`, NaN where a frame is not used, with that of the worst frame where it is better elsewhere.

    And of the next, as long as that helps.
    """
    for _ in range(len(motion)):
        rest = residuals(level, motion)
        worst = int(unexplained(rest, width(rest)).argmax())
        other = motion.clone()
        other[worst] = torch.nan
        if other.isfinite().all((1, 2)).sum() < 2:
            break
        scene, pattern, _ = explained(level, other)
        other[[worst]], _ = match(scene, level.frames[[worst]] - pattern, level, model, standing=False)
        near = apart(motion[[worst]], other[[worst]], level.frames) < FAR
        if near or not prefers(level, motion, other):
            break
        motion = other
    return motion
