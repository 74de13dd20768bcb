"""What motions explain of frames, sample by sample: most of the frame decides, whoever walks through the rest."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.noise import MAD
from deepir.registration.pyramid import Level, sample

SEEN = 2.5  # frames that must show a place of the scene, for it to say something
TAILS = 4.0  # variances, from which a residual counts little more,
BOUND = 20.0  # and standard deviations, from which no more, and as which a sample counts that others do not see
CLEAR = 0.03  # nats that each sample gains from motions that are better
PLAIN = 0.75  # that each sample costs at most where most frames show one scene and nothing else
PASSES = 4  # over scene and pattern


def prefers(level: Level, before: Tensor, after: Tensor) -> bool:
    """Whether other motions `(N, 3, 3)` explain more of frames `(N, h, w)`; NaN where a frame is not used.

    By a likelihood with heavy tails, of residuals as wide as those of the better. Samples that no others see are not
    explained: else motions would be best that share nothing.
    """
    had, has = (residuals(level, motion) for motion in (before, after))
    usual = min(width(had), width(has))
    gained = unexplained(had, usual).sum() - unexplained(has, usual).sum()
    return float(gained) > CLEAR * had.numel()


def costs(level: Level, motion: Tensor) -> float:
    """How much motions `(N, 3, 3)` leave unexplained of frames, in nats for each sample; near `PLAIN` if that is noise."""
    rest = residuals(level, motion)
    return float(unexplained(rest, width(rest)).sum()) / rest.numel()


def width(rest: Tensor) -> float:
    """Robust standard deviation of residuals whose magnitudes are known where they are finite."""
    known = rest[rest.isfinite()]
    return max(MAD * float(known.median()), 1e-12) if len(known) else torch.inf


def unexplained(rest: Tensor, usual: float) -> Tensor:
    """Minus the log-likelihood of each frame `(N,)`, the rest of which has a `usual` width."""
    return torch.log1p((rest / usual).clamp_max(BOUND).square() / TAILS).double().sum((1, 2))


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
    """Scene and pattern `(h, w)`, and the samples `(M, h, w)` of the M frames that are used which more of them see.

    Both are medians over these frames, so that somebody who is in a place in a few of them is in neither.
    """
    used = motion.isfinite().all((1, 2))
    level, motion = level.of(used), motion[used]
    back, pattern = torch.linalg.inv(motion), torch.zeros_like(level.weight)
    seen = sample(level.frames, back, level)[1] > 0
    often = (sample(seen.sum(0)[None].float(), motion, level)[0] > SEEN) & (level.weight > 0)
    for _ in range(PASSES):
        scene = _median(sample(level.frames - pattern, back, level)[0], seen)
        expected, known = sample(scene[None], motion, level)
        pattern = _median(level.frames - expected, often & (known > 0))
    return scene, pattern, often


def _median(images: Tensor, known: Tensor) -> Tensor:
    """That over the known of images `(N, h, w)`, zero where none is."""
    return images.where(known, torch.nan).nanmedian(0).values.nan_to_num(0)
