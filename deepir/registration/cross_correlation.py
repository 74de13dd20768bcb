"""First motions: correlation over all shifts and some rotations, with a frame that many others agree with."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepir.operators.motion_models import rotation
from deepir.registration.pyramid import Level, sample

ANGLES = [math.radians(a) for a in (0, -2, 2, -4, 4, -6, 6, -8, 8)]
#: Factor by which the correlation of a turned frame has to be higher than that of the best start before it: where
#: depth or a plain scene makes all of them low, one is the highest by chance, by 1 to 3 %.
TURN_MARGIN = 1.08
WHITEN = 0.7  # 0: plain correlation, 1: phase correlation
PASSED = 0.12  # cycles a px of the level: Gaussian in which lags are compared
CLEAR = 8.0  # deviations of the correlations at all lags: other scenes seldom reach it, the same 11 and more,
#: Or, as the root of the number of px limits it, so many times that, and at least so much.
LITTLE, LEAST = 0.12, 4.5
TRIED = 4  # frames that are tried as the one to compare with


def search(images: Tensor, level: Level, model: str, standing: bool) -> tuple[Tensor, Tensor]:
    """Motions `(N, 3, 3)` of images `(N, h, w)` relative to one of them, and how clearly `(N,)` each stands out.

    That one is the first with which most agree; the frame itself stands out without bound.
    """
    n = len(images)
    waiting, best = list(range(n)), None
    for _ in range(min(TRIED, n)):
        if not waiting:
            break
        motion, clear = match(images[waiting[0]], images, level, model, standing)
        motion[waiting[0]], clear[waiting[0]] = torch.eye(3, dtype=torch.float64), math.inf
        if best is None or (clear > 1).sum() > (best[1] > 1).sum():
            best = motion, clear
        if 2 * (clear > 1).sum() > n:
            break
        waiting = [k for k in waiting if not clear[k] > 1]
    assert best is not None
    return best


def chance(level: Level) -> float:
    """Deviations that a match has to stand out by; `clear` is in units of it."""
    return min(CLEAR, max(LEAST, LITTLE * level.weight.numel() ** 0.5))


def match(
    reference: Tensor, images: Tensor, level: Level, model: str, standing: bool
) -> tuple[Tensor, Tensor]:
    """The best motion `(N, 3, 3)` of images `(N, h, w)` against a reference `(h, w)`, and how clear it is."""
    h, w = reference.shape
    spectra = torch.fft.rfft2(images * window(h, w)).conj()
    turns = rotation(torch.tensor(ANGLES[:1] if model == "shift" else ANGLES, dtype=torch.float64))
    found = torch.eye(3, dtype=torch.float64).repeat(len(images), 1, 1)
    height = torch.zeros(len(images))
    for k, turn in enumerate(turns):
        turned, _ = sample(reference[None], turn[None], level)
        surface = correlation(turned[0], spectra, (h, w), standing)
        peak, at = surface.flatten(1).max(1)
        peak = peak / surface.std((1, 2)).clamp_min(1e-20)
        # frame(p) = reference(turn (p + lag)): the lag is found in the turned reference's axes
        lag = torch.stack(((at % w + w // 2) % w - w // 2, (at // w + h // 2) % h - h // 2), -1)
        motion = turn.repeat(len(images), 1, 1)
        motion[:, :2, 2] = lag.double() * level.factor @ turn[:2, :2].T
        better = peak > height * (TURN_MARGIN if k else 1.0)
        found[better], height[better] = motion[better], peak[better]
    return found, height.double() / chance(level)


def window(h: int, w: int) -> Tensor:
    """A Hann window `(h, w)`."""
    return torch.hann_window(h, periodic=False)[:, None] * torch.hann_window(w, periodic=False)


def correlation(reference: Tensor, spectra: Tensor, size: tuple[int, int], standing: bool) -> Tensor:
    """Partly whitened cross-correlation `(N, h, w)` with the reference; lag zero at [0, 0].

    standing: a fixed pattern is in the images. It correlates with itself at lag zero, a residue of stripes along
    the axes; a scene is smooth there. So these lags are replaced by their neighbours' mean *before* the whitening.
    (Whitening: Knapp & Carter 1976; phase correlation: Kuglin & Hines 1975.)
    """
    h, w = size
    cross = spectra * torch.fft.rfft2(reference * window(h, w))
    if standing:
        lags = torch.fft.irfft2(cross, s=size)
        lags[:, :, 0] = (lags[:, :, 1] + lags[:, :, -1]) / 2
        lags[:, 0] = (lags[:, 1] + lags[:, -1]) / 2
        cross = torch.fft.rfft2(lags)
    power = cross.abs()
    fy, fx = torch.fft.fftfreq(h)[:, None], torch.fft.rfftfreq(w)
    band = torch.exp(-0.5 * (fy**2 + fx**2) / PASSED**2)
    floor = 1e-3 * power.amax((1, 2), keepdim=True) + 1e-20
    return torch.fft.irfft2(band * cross / (power + floor) ** WHITEN, s=size)
