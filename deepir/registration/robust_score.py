"""Robust score of motions: log-likelihood of residuals after median scene and pattern, most of the frame deciding.

An object that moves by itself is in neither median, its residuals are bounded, and the blocks of the frame that change
most do not count. So the score compares motions although something moves through part of the frame.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.registration.block_likelihood import DISTINCT_DISTANCE, corner_distance
from deepir.registration.preprocess import Level, sample
from deepir.registration.shift_likelihood import match_to_reference

MIN_CLEAR_GAIN = 0.08  # nats per sample; motions that gain more are better beyond doubt
MIN_OVERLAPPING = 2.5  # frames, interpolated; a scene point that fewer frames show says nothing


def accept_by_residuals(level: Level, before: Tensor, after: Tensor) -> bool:
    """Decide for motions `after` if they gain `MIN_CLEAR_GAIN` over `before`; arguments as `log_likelihood_ratio`."""
    return log_likelihood_ratio(level, before, after) >= MIN_CLEAR_GAIN


def log_likelihood_ratio(level: Level, before: Tensor, after: Tensor) -> float:
    """Nats per sample that motions `after` gain over others: trimmed mean over nine blocks of the frame.

    The likelihood is heavy-tailed; its scale is that of the better motions. Samples that no other frame shows count as
    unexplained, else motions without overlap would score best. Any motions explain two frames: their ratio is zero.
    Motions are `(N, 3, 3)`, NaN where a frame is not used.
    """
    if min(int(motion.isfinite().all((1, 2)).sum()) for motion in (before, after)) < MIN_OVERLAPPING:
        return 0.0
    residuals_before, residuals_after = (absolute_residuals(level, motion) for motion in (before, after))
    sigma = min(robust_sigma(residuals_before), robust_sigma(residuals_after))
    gain = (sample_nll(residuals_before, sigma) - sample_nll(residuals_after, sigma)).mean(0)
    block_gains = sorted(float(block.mean()) for rows in gain.chunk(3) for block in rows.chunk(3, 1))
    central = block_gains[2:-2] or block_gains  # frames of a few lines have fewer blocks
    return sum(central) / len(central)


def robust_nll(level: Level, motion: Tensor) -> float:
    """Mean negative log-likelihood, nats per sample, of the used frames at motions `(N, 3, 3)`, NaN if not used."""
    residual = absolute_residuals(level, motion)[motion.isfinite().all((1, 2))]
    return float(sample_nll(residual, robust_sigma(residual)).mean())


def robust_sigma(residual: Tensor) -> float:
    """Robust standard deviation of residuals from their magnitudes `(...)`; infinite ones do not count."""
    finite = residual[residual.isfinite()]
    return max(MAD_TO_SIGMA * float(finite.median()), 1e-12) if len(finite) else torch.inf


def sample_nll(residual: Tensor, sigma: float) -> Tensor:
    """Negative log-likelihood of each sample, nats, up to a constant: Cauchy, bounded.

    `residual` are magnitudes `(N, h, w)`, infinite where no other frame predicts the sample; these count as the bound.
    """
    bounded = (residual / sigma).where(residual.isfinite(), 10.0).clamp_max(10.0)  # sigma
    return torch.log1p(bounded.square() / 4.0)  # squared scale of the tail, sigma squared


def absolute_residuals(level: Level, motion: Tensor) -> Tensor:
    """Magnitudes `(N, h, w)` of frames less scene and pattern of `median_model`, at motions `(N, 3, 3)`.

    Infinite where no other frame predicts a sample, and for frames that are not used, whose motion is NaN.
    """
    used = motion.isfinite().all((1, 2))
    residual = torch.full_like(level.frames, torch.inf)
    if used.any():
        scene, pattern, overlapping = median_model(level, motion)
        expected, known = sample(scene[None], motion[used], level)
        magnitude = (level.frames[used] - expected - pattern).abs()
        residual[used] = magnitude.where(overlapping & (known > 0), torch.inf)
    return residual


def median_model(level: Level, motion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Scene and pattern at motions `(N, 3, 3)`, NaN if not used, alternately, as medians over the used frames.

    An object that covers a point in few frames is in neither median. With little motion, scene and pattern separate
    slowly, so the pattern is extrapolated; unconverged, too large motions would score best.

    Returns:
        Scene and pattern `(h, w)`, and the samples of the M used frames that other frames show, too, `(M, h, w)` bool.
    """
    used = motion.isfinite().all((1, 2))
    level, motion = level.subset(used), motion[used]
    inverse, pattern = torch.linalg.inv(motion), torch.zeros_like(level.weight)
    previous = pattern
    visible = sample(level.frames, inverse, level)[1] > 0
    n_visible, _ = sample(visible.sum(0)[None].float(), motion, level)
    overlapping = (n_visible > MIN_OVERLAPPING) & (level.weight > 0)
    for _ in range(10):
        extrapolated = pattern + 0.8 * (pattern - previous)  # share of its last change
        scene = _masked_median(sample(level.frames - extrapolated, inverse, level)[0], visible)
        expected, known = sample(scene[None], motion, level)
        previous, pattern = pattern, _masked_median(level.frames - expected, overlapping & (known > 0))
    return scene, pattern, overlapping


def _masked_median(images: Tensor, known: Tensor) -> Tensor:
    """Median `(h, w)` over the known samples, `(N, h, w)` bool, of images `(N, h, w)`; zero where none is known."""
    order, last = images.where(known, torch.inf).sort(0).values, known.sum(0) - 1
    middle = [order.gather(0, rank.clamp_min(0)[None])[0] for rank in (last // 2, last - last // 2)]
    return torch.where(last >= 0, (middle[0] + middle[1]) / 2, 0)


def reregister_worst_frames(level: Level, motion: Tensor, model: str) -> Tensor:
    """Search the worst frame again in the median scene of the others, as long as that clearly raises the score.

    Of motions `(N, 3, 3)`, NaN where a frame is not used, at most a few change. The model "shift" searches shifts only,
    any other model rotations, too.
    """
    used = motion.isfinite().all((1, 2))
    for _ in range(min(len(motion), 32)):  # each search takes the time of all frames
        residual = absolute_residuals(level, motion)
        frame_nll = sample_nll(residual, robust_sigma(residual)).mean((1, 2))
        worst = [int(frame_nll.where(used, -torch.inf).argmax())]
        candidate = motion.clone()
        candidate[worst] = torch.nan
        if candidate.isfinite().all((1, 2)).sum() < 3:
            break
        scene, pattern, _ = median_model(level, candidate)
        image = level.frames[worst] - pattern
        candidate[worst], _ = match_to_reference(scene, image, level, model, pattern_present=False)
        if corner_distance(motion[worst], candidate[worst], level.frames) < DISTINCT_DISTANCE:
            break
        if not accept_by_residuals(level, motion, candidate):
            break
        motion = candidate
    return motion
