"""Frames that are sought once more, each in what all others show."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.block_vote import FAR, apart
from deepir.registration.cross_correlation import match
from deepir.registration.pyramid import Level
from deepir.registration.robust_score import explained, log_likelihood_ratio, residuals, unexplained, width

FEWEST = 3  # other frames in which one is sought
CLEAR = 0.08  # nats by which each sample is better explained where it is found


def repaired(level: Level, motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)`, NaN where a frame is not used, with that of the worst that is, where it is better elsewhere.

    And of the next, as long as that helps.
    """
    used = motion.isfinite().all((1, 2))
    for _ in range(len(motion)):
        rest = residuals(level, motion)
        worst = int(unexplained(rest, width(rest)).mean((1, 2)).where(used, -torch.inf).argmax())
        other = motion.clone()
        other[worst] = torch.nan
        if other.isfinite().all((1, 2)).sum() < FEWEST:
            break
        scene, pattern, _ = explained(level, other)
        other[[worst]], _ = match(scene, level.frames[[worst]] - pattern, level, model, standing=False)
        near = apart(motion[[worst]], other[[worst]], level.frames) < FAR
        if near or log_likelihood_ratio(level, motion, other) < CLEAR:
            break
        motion = other
    return motion
