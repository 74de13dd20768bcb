"""Frames that are sought once more, each in what all others show."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.registration.block_vote import DISTINCT_DISTANCE, corner_distance
from deepir.registration.cross_correlation import match_to_reference
from deepir.registration.pyramid import Level
from deepir.registration.robust_score import (
    MIN_CLEAR_GAIN,
    absolute_residuals,
    log_likelihood_ratio,
    median_model,
    robust_sigma,
    sample_nll,
)

MIN_OTHER_FRAMES = 3  # frames in which another one is searched


def reregister_worst_frames(level: Level, motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)`, NaN where a frame is not used, with that of the worst that is, where it is better elsewhere.

    And of the next, as long as that helps.
    """
    used = motion.isfinite().all((1, 2))
    for _ in range(len(motion)):
        residual = absolute_residuals(level, motion)
        worst = int(
            sample_nll(residual, robust_sigma(residual)).mean((1, 2)).where(used, -torch.inf).argmax()
        )
        candidate = motion.clone()
        candidate[worst] = torch.nan
        if candidate.isfinite().all((1, 2)).sum() < MIN_OTHER_FRAMES:
            break
        rest = median_model(level, candidate)
        candidate[[worst]], _ = match_to_reference(
            rest.scene, level.frames[[worst]] - rest.pattern, level, model, pattern_present=False
        )
        unchanged = corner_distance(motion[[worst]], candidate[[worst]], level.frames) < DISTINCT_DISTANCE
        if unchanged or log_likelihood_ratio(level, motion, candidate) < MIN_CLEAR_GAIN:
            break
        motion = candidate
    return motion
