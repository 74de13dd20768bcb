"""Initial motions by exhaustive search: whitened cross-correlation over all shifts and a grid of rotations."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.operators.motion_models import rotation
from deepir.registration.pyramid import Level, sample

SEARCH_ANGLES = [math.radians(a) for a in (0, -2, 2, -4, 4, -6, 6, -8, 8)]  # radians
#: Ratio by which the peak of a rotated frame must exceed the best one before it. Among several low peaks (depth, plain
#: scenes) the highest exceeds the others by 1 to 3 % by chance.
ROTATION_MARGIN = 1.08
WHITENING_EXPONENT = 0.7  # 0: cross-correlation, 1: phase correlation
BAND_SIGMA = 0.12  # cycles per px of the level; Gaussian band in which spectra are correlated
MAX_REFERENCES = 4  # frames tried as the reference


@dataclass(frozen=True)
class PeakCriteria:
    """Height of a correlation peak, in standard deviations over all lags, at which two frames match.

    The threshold is `per_root_pixel` times the root of the number of pixels, within these bounds.
    """

    per_root_pixel: float = 0.12
    min_threshold: float = 4.5
    max_threshold: float = 8.0  # frames of other scenes seldom reach it, those of one scene reach 11 and more


PEAK = PeakCriteria()


def correlation_search(
    images: Tensor, level: Level, model: str, pattern_present: bool
) -> tuple[Tensor, Tensor]:
    """Register all images to the one that most of them match, the first of these.

    Args:
        images: `(N, h, w)`.
        level: their level.
        model: "shift" searches shifts only; any other model searches rotations, too.
        pattern_present: True if the images contain the fixed pattern.

    Returns:
        Motions `(N, 3, 3)` relative to the reference, and match scores `(N,)`: height of the peak over the detection
        threshold, infinite for the reference itself.
    """
    n = len(images)
    candidates, best = list(range(n)), None
    for _ in range(min(MAX_REFERENCES, n)):
        if not candidates:
            break
        reference = candidates[0]
        motion, match_score = match_to_reference(images[reference], images, level, model, pattern_present)
        motion[reference], match_score[reference] = torch.eye(3, dtype=torch.float64), math.inf
        if best is None or (match_score > 1).sum() > (best[1] > 1).sum():
            best = motion, match_score
        if 2 * (match_score > 1).sum() > n:
            break
        candidates = [k for k in candidates if not match_score[k] > 1]
    assert best is not None
    return best


def detection_threshold(level: Level) -> float:
    """Peak height, in standard deviations over all lags, at which the match score is one."""
    return min(PEAK.max_threshold, max(PEAK.min_threshold, PEAK.per_root_pixel * level.weight.numel() ** 0.5))


def match_to_reference(
    reference: Tensor, images: Tensor, level: Level, model: str, pattern_present: bool
) -> tuple[Tensor, Tensor]:
    """Register images to a reference: highest correlation peak over all shifts and rotations.

    Args:
        reference: `(h, w)`.
        images: `(N, h, w)`.
        level: their level.
        model: "shift" searches shifts only; any other model searches rotations, too.
        pattern_present: True if the images contain the fixed pattern.

    Returns:
        Motions `(N, 3, 3)`, accurate to a pixel of the level, and match scores `(N,)`.
    """
    h, w = reference.shape
    spectra = torch.fft.rfft2(images * hann_window(h, w)).conj()
    angles = SEARCH_ANGLES[:1] if model == "shift" else SEARCH_ANGLES
    best_motion = torch.eye(3, dtype=torch.float64).repeat(len(images), 1, 1)
    best_height = torch.zeros(len(images))
    for k, turn in enumerate(rotation(torch.tensor(angles, dtype=torch.float64))):
        rotated, _ = sample(reference[None], turn[None], level)
        surface = whitened_correlation(rotated[0], spectra, pattern_present)
        peak, index = surface.flatten(1).max(1)
        height = peak / surface.std((1, 2)).clamp_min(1e-20)
        # frame(p) = reference(turn (p + lag)): the lag is in the axes of the rotated reference
        lag = torch.stack(((index % w + w // 2) % w - w // 2, (index // w + h // 2) % h - h // 2), -1)
        motion = turn.repeat(len(images), 1, 1)
        motion[:, :2, 2] = lag.double() * level.factor @ turn[:2, :2].T
        improved = height > best_height * (ROTATION_MARGIN if k else 1.0)
        best_motion[improved], best_height[improved] = motion[improved], height[improved]
    return best_motion, best_height.double() / detection_threshold(level)


def hann_window(h: int, w: int) -> Tensor:
    """Hann window `(h, w)`: a taper against the edges of the frame."""
    return torch.hann_window(h, periodic=False)[:, None] * torch.hann_window(w, periodic=False)


def whitened_correlation(reference: Tensor, spectra: Tensor, pattern_present: bool) -> Tensor:
    """Partly whitened, band-limited cross-correlation of a reference with images.

    The fixed pattern correlates with itself at lag zero, its lines along the axes; the correlation of a scene is smooth
    there. So with a pattern the lags along both axes are replaced by the mean of their neighbours before whitening.

    Args:
        reference: `(h, w)`.
        spectra: `(N, h, w / 2 + 1)`, conjugate spectra of the tapered images.
        pattern_present: True if the images contain the fixed pattern.

    Returns:
        Correlation `(N, h, w)`, lag zero at [0, 0].

    Source: Knapp and Carter, The generalized correlation method, IEEE Trans. ASSP 24 (1976); phase correlation: Kuglin
    and Hines, IEEE Conf. Cybernetics and Society (1975).
    """
    h, w = size = (reference.shape[0], reference.shape[1])
    cross = spectra * torch.fft.rfft2(reference * hann_window(h, w))
    if pattern_present:
        lags = torch.fft.irfft2(cross, s=size)
        lags[:, :, 0] = (lags[:, :, 1] + lags[:, :, -1]) / 2
        lags[:, 0] = (lags[:, 1] + lags[:, -1]) / 2
        cross = torch.fft.rfft2(lags)
    power = cross.abs()
    fy, fx = torch.fft.fftfreq(h)[:, None], torch.fft.rfftfreq(w)
    band = torch.exp(-0.5 * (fy**2 + fx**2) / BAND_SIGMA**2)
    floor = 1e-3 * power.amax((1, 2), keepdim=True) + 1e-20
    return torch.fft.irfft2(band * cross / (power + floor) ** WHITENING_EXPONENT, s=size)
