"""What motions explain of frames, sample by sample: most of the frame decides, whoever walks through the rest."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.registration.pyramid import Level, sample

SEEN = 2.5  # frames that must show a place of the scene, for it to say something
TAILS = 4.0  # variances, from which a residual counts little more,
BOUND = (
    10.0  # and standard deviations, from which no more, and as which a sample counts that others do not see
)
SPARED = 2  # of the nine parts, at either end
#: Passes over scene and pattern, and the share of the last one's change that each goes on by: where the camera moves
#: little they settle slowly, and motions would be best that are too large.
PASSES, HASTE = 10, 0.8


def log_likelihood_ratio(level: Level, before: Tensor, after: Tensor) -> float:
    """By how many nats a sample other motions `(N, 3, 3)` explain more of frames; NaN where a frame is not used.

    By a likelihood with heavy tails, of residuals as wide as those of the better. Samples that no others see are not
    explained: else motions would be best that share nothing. Of nine parts of the frame, those that gain most and
    least do not count: somebody may walk there. Two frames are explained by anything: they gain and lose nothing.
    """
    if min(int(motion.isfinite().all((1, 2)).sum()) for motion in (before, after)) < SEEN:
        return 0.0
    had, has = (residuals(level, motion) for motion in (before, after))
    usual = min(width(had), width(has))
    gained = (unexplained(had, usual) - unexplained(has, usual)).mean(0)
    parts = sorted(float(part.mean()) for rows in gained.chunk(3) for part in rows.chunk(3, 1))
    middle = parts[SPARED:-SPARED] or parts  # frames of a few lines have fewer
    return sum(middle) / len(middle)


def cost(level: Level, motion: Tensor) -> float:
    """How much motions `(N, 3, 3)` leave unexplained of the frames that are used, in nats for each sample."""
    rest = residuals(level, motion)[motion.isfinite().all((1, 2))]
    return float(unexplained(rest, width(rest)).mean())


def width(rest: Tensor) -> float:
    """Robust standard deviation of residuals whose magnitudes are known where they are finite."""
    known = rest[rest.isfinite()]
    return max(MAD_TO_SIGMA * float(known.median()), 1e-12) if len(known) else torch.inf


def unexplained(rest: Tensor, usual: float) -> Tensor:
    """Minus the log-likelihood of samples `(N, h, w)`, the rest of which has a `usual` width."""
    return torch.log1p((rest / usual).where(rest.isfinite(), BOUND).clamp_max(BOUND).square() / TAILS)


def residuals(level: Level, motion: Tensor) -> Tensor:
    """Magnitudes `(N, h, w)` of what is neither scene nor pattern; infinite where no other frames see the place."""
    used = motion.isfinite().all((1, 2))
    rest = torch.full_like(level.frames, torch.inf)
    if used.any():
        scene, pattern, often = explained(level, motion)
        expected, known = sample(scene[None], motion[used], level)
        rest[used] = (level.frames[used] - expected - pattern).abs().where(often & (known > 0), torch.inf)
    return rest


def explained(level: Level, motion: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Scene and pattern `(h, w)`, and which samples `(M, h, w)` of the M frames that are used others see, too.

    Both are medians over these frames, so that somebody who is in a place in a few of them is in neither.
    """
    used = motion.isfinite().all((1, 2))
    level, motion = level.of(used), motion[used]
    back, pattern = torch.linalg.inv(motion), torch.zeros_like(level.weight)
    before = pattern
    seen = sample(level.frames, back, level)[1] > 0
    often = (sample(seen.sum(0)[None].float(), motion, level)[0] > SEEN) & (level.weight > 0)
    for _ in range(PASSES):
        ahead = pattern + HASTE * (pattern - before)
        scene = _median(sample(level.frames - ahead, back, level)[0], seen)
        expected, known = sample(scene[None], motion, level)
        before, pattern = pattern, _median(level.frames - expected, often & (known > 0))
    return scene, pattern, often


def _median(images: Tensor, known: Tensor) -> Tensor:
    """That over the known of images `(N, h, w)`, of two middle ones the mean; zero where none is known."""
    order, last = images.where(known, torch.inf).sort(0).values, known.sum(0) - 1
    middle = [order.gather(0, at.clamp_min(0)[None])[0] for at in (last // 2, last - last // 2)]
    return torch.where(last >= 0, (middle[0] + middle[1]) / 2, 0)
