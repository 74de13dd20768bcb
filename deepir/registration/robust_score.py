"""What motions explain of frames, sample by sample: most of the frame decides, whoever walks through the rest.

Frames that are sought once more, each in what all others show."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.arrays.median import MAD
from deepir.registration.block_likelihood import DISTINCT_DISTANCE, corner_distance
from deepir.registration.cross_correlation import match_to_reference
from deepir.registration.pyramid import Level, sample

MIN_OVERLAPPING = 2.5  # frames, interpolated; a scene point that fewer frames show says nothing
TAIL_VARIANCE = 4.0  # variances; squared scale of the heavy-tailed (Cauchy) likelihood
MAX_RESIDUAL = (
    10.0  # standard deviations; bound of a residual, and that of a sample that no other frame shows
)
N_TRIMMED = 2  # of nine blocks, left out at either end of the sorted gains
MEDIAN_PASSES = 10  # alternations of median scene and median pattern
#: Share of its last change by which the pattern is extrapolated in each pass. With little motion, scene and pattern
#: separate slowly; unconverged, too large motions would score best.
EXTRAPOLATION = 0.8
MIN_CLEAR_GAIN = 0.08  # nats per sample; motions that gain more are better beyond doubt

MIN_OTHER_FRAMES = 3  # frames in which another one is searched


def log_likelihood_ratio(level: Level, before: Tensor, after: Tensor) -> float:
    """By how many nats a sample other motions `(N, 3, 3)` explain more of frames; NaN where a frame is not used.

    By a likelihood with heavy tails, of residuals as wide as those of the better. Samples that no others see are not
    explained: else motions would be best that share nothing. Of nine parts of the frame, those that gain most and
    least do not count: somebody may walk there. Two frames are explained by anything: they gain and lose nothing.
    """
    if min(int(motion.isfinite().all((1, 2)).sum()) for motion in (before, after)) < MIN_OVERLAPPING:
        return 0.0
    residuals_before, residuals_after = (absolute_residuals(level, motion) for motion in (before, after))
    sigma = min(robust_sigma(residuals_before), robust_sigma(residuals_after))
    sample_gain = (sample_nll(residuals_before, sigma) - sample_nll(residuals_after, sigma)).mean(0)
    block_gains = sorted(float(part.mean()) for rows in sample_gain.chunk(3) for part in rows.chunk(3, 1))
    central = block_gains[N_TRIMMED:-N_TRIMMED] or block_gains  # frames of a few lines have fewer
    return sum(central) / len(central)


def robust_nll(level: Level, motion: Tensor) -> float:
    """How much motions `(N, 3, 3)` leave unexplained of the frames that are used, in nats for each sample."""
    residual = absolute_residuals(level, motion)[motion.isfinite().all((1, 2))]
    return float(sample_nll(residual, robust_sigma(residual)).mean())


def robust_sigma(residual: Tensor) -> float:
    """Robust standard deviation of residuals whose magnitudes are known where they are finite."""
    finite = residual[residual.isfinite()]
    return max(MAD * float(finite.median()), 1e-12) if len(finite) else torch.inf


def sample_nll(residual: Tensor, sigma: float) -> Tensor:
    """Minus the log-likelihood of samples `(N, h, w)`, the rest of which has a `usual` width."""
    return torch.log1p(
        (residual / sigma).where(residual.isfinite(), MAX_RESIDUAL).clamp_max(MAX_RESIDUAL).square()
        / TAIL_VARIANCE
    )


def absolute_residuals(level: Level, motion: Tensor) -> Tensor:
    """Magnitudes `(N, h, w)` of what is neither scene nor pattern; infinite where no other frames see the place."""
    used = motion.isfinite().all((1, 2))
    residual = torch.full_like(level.frames, torch.inf)
    if used.any():
        model = median_model(level, motion)
        expected, known = sample(model.scene[None], motion[used], level)
        residual[used] = (
            (level.frames[used] - expected - model.pattern)
            .abs()
            .where(model.overlapping & (known > 0), torch.inf)
        )
    return residual


@dataclass(frozen=True)
class MedianModel:
    """Robust model of frames at given motions.

    scene, pattern: `(h, w)`. overlapping: `(M, h, w)` bool, samples of the M used frames that others see, too.
    """

    scene: Tensor
    pattern: Tensor
    overlapping: Tensor


def median_model(level: Level, motion: Tensor) -> MedianModel:
    """Scene and pattern `(h, w)`, and which samples `(M, h, w)` of the M frames that are used others see, too.

    Both are medians over these frames, so that somebody who is in a place in a few of them is in neither.
    """
    used = motion.isfinite().all((1, 2))
    level, motion = level.subset(used), motion[used]
    inverse, pattern = torch.linalg.inv(motion), torch.zeros_like(level.weight)
    previous = pattern
    visible = sample(level.frames, inverse, level)[1] > 0
    overlapping = (sample(visible.sum(0)[None].float(), motion, level)[0] > MIN_OVERLAPPING) & (
        level.weight > 0
    )
    for _ in range(MEDIAN_PASSES):
        extrapolated = pattern + EXTRAPOLATION * (pattern - previous)
        scene = _masked_median(sample(level.frames - extrapolated, inverse, level)[0], visible)
        expected, known = sample(scene[None], motion, level)
        previous, pattern = pattern, _masked_median(level.frames - expected, overlapping & (known > 0))
    return MedianModel(scene, pattern, overlapping)


def _masked_median(images: Tensor, known: Tensor) -> Tensor:
    """That over the known of images `(N, h, w)`, of two middle ones the mean; zero where none is known."""
    order, last = images.where(known, torch.inf).sort(0).values, known.sum(0) - 1
    middle = [order.gather(0, at.clamp_min(0)[None])[0] for at in (last // 2, last - last // 2)]
    return torch.where(last >= 0, (middle[0] + middle[1]) / 2, 0)


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
