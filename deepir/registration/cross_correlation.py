"""First motions: correlation over all shifts and some rotations, with a frame that many others agree with."""

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
    """Height of a correlation peak, in standard deviations over all lags, from which two frames match."""

    max_threshold: float = 8.0  # frames of other scenes seldom reach it, those of one scene reach 11 and more
    per_root_pixel: float = (
        0.12  # of small frames the threshold is this, times the root of the number of pixels
    )
    min_threshold: float = 4.5  # and at least this


PEAK = PeakCriteria()


def correlation_search(
    images: Tensor, level: Level, model: str, pattern_present: bool
) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of images `(N, h, w)` relative to one of them, and how clearly `(N,)` each stands out.

    That one is the first with which most agree; the frame itself stands out without bound.
    """
    n = len(images)
    candidates, best = list(range(n)), None
    for _ in range(min(MAX_REFERENCES, n)):
        if not candidates:
            break
        motion, match_score = match_to_reference(images[candidates[0]], images, level, model, pattern_present)
        motion[candidates[0]], match_score[candidates[0]] = torch.eye(3, dtype=torch.float64), math.inf
        if best is None or (match_score > 1).sum() > (best[1] > 1).sum():
            best = motion, match_score
        if 2 * (match_score > 1).sum() > n:
            break
        candidates = [k for k in candidates if not match_score[k] > 1]
    assert best is not None
    return best


def detection_threshold(level: Level) -> float:
    """Deviations that a match has to stand out by; `clear` is in units of it."""
    return min(PEAK.max_threshold, max(PEAK.min_threshold, PEAK.per_root_pixel * level.weight.numel() ** 0.5))


def match_to_reference(
    reference: Tensor, images: Tensor, level: Level, model: str, pattern_present: bool
) -> tuple[Tensor, Tensor]:
    """The best motion `(N, 3, 3)` of images `(N, h, w)` against a reference `(h, w)`, and how clear it is."""
    h, w = reference.shape
    spectra = torch.fft.rfft2(images * hann_window(h, w)).conj()
    rotations = rotation(
        torch.tensor(SEARCH_ANGLES[:1] if model == "shift" else SEARCH_ANGLES, dtype=torch.float64)
    )
    best_motion = torch.eye(3, dtype=torch.float64).repeat(len(images), 1, 1)
    best_height = torch.zeros(len(images))
    for k, turn in enumerate(rotations):
        rotated, _ = sample(reference[None], turn[None], level)
        surface = whitened_correlation(rotated[0], spectra, (h, w), pattern_present)
        peak, peak_index = surface.flatten(1).max(1)
        peak = peak / surface.std((1, 2)).clamp_min(1e-20)
        # frame(p) = reference(turn (p + lag)): the lag is found in the turned reference's axes
        lag = torch.stack(
            ((peak_index % w + w // 2) % w - w // 2, (peak_index // w + h // 2) % h - h // 2), -1
        )
        motion = turn.repeat(len(images), 1, 1)
        motion[:, :2, 2] = lag.double() * level.factor @ turn[:2, :2].T
        improved = peak > best_height * (ROTATION_MARGIN if k else 1.0)
        best_motion[improved], best_height[improved] = motion[improved], peak[improved]
    return best_motion, best_height.double() / detection_threshold(level)


def hann_window(h: int, w: int) -> Tensor:
    """A Hann window `(h, w)`."""
    return torch.hann_window(h, periodic=False)[:, None] * torch.hann_window(w, periodic=False)


def whitened_correlation(
    reference: Tensor, spectra: Tensor, size: tuple[int, int], pattern_present: bool
) -> Tensor:
    """Partly whitened cross-correlation `(N, h, w)` with the reference; lag zero at [0, 0].

    standing: a fixed pattern is in the images. It correlates with itself at lag zero, a residue of stripes along
    the axes; a scene is smooth there. So these lags are replaced by their neighbours' mean *before* the whitening.
    (Whitening: Knapp & Carter 1976; phase correlation: Kuglin & Hines 1975.)
    """
    h, w = size
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
