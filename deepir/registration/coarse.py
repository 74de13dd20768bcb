"""First guesses of each frame's motion: correlation with the reference over all shifts, a few rotations."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.registration.motion import rotation, transform
from deepir.registration.pyramid import Level, sample

ANGLES = [math.radians(a) for a in (0, -2, 2, -4, 4, -6, 6, -8, 8)]
WHITEN = 0.7  # 0: plain correlation, 1: phase correlation


def guesses(reference: Tensor, level: Level, model: str, keep: int = 4) -> Tensor:
    """The `keep` best starts `(N, keep, 3, 3)` of a level's frames against a reference `(h, w)`."""
    turns = rotation(torch.tensor(ANGLES[:1] if model == "shift" else ANGLES, dtype=torch.float64))
    surface = torch.stack([correlation(turned(reference, level, turn), level.flat) for turn in turns], 1)
    return peaks(surface, turns, level.factor, keep)


def turned(reference: Tensor, level: Level, turn: Tensor) -> Tensor:
    """The reference as a camera turned by `turn` `(3, 3)` sees it."""
    h, w = reference.shape
    points = transform(turn, level.points())
    return sample(reference[None, None], points[None], level).reshape(h, w)


def correlation(reference: Tensor, images: Tensor) -> Tensor:
    """Partly whitened cross-correlation `(N, h, w)` of windowed images with the reference; lag zero at [0,
    0].

    A fixed pattern correlates with itself at lag zero, a residue of stripes along the axes; a scene is smooth
    there. So these lags are replaced by their neighbours' mean *before* the whitening: [0, 0] is no trap.
    (Whitening: Knapp & Carter 1976; phase correlation: Kuglin & Hines 1975.)
    """
    h, w = images.shape[1:]
    window = torch.hann_window(h, periodic=False)[:, None] * torch.hann_window(w, periodic=False)
    cross = torch.fft.rfft2(images * window).conj() * torch.fft.rfft2(reference * window)
    lags = torch.fft.irfft2(cross, s=(h, w))
    lags[:, :, 0] = (lags[:, :, 1] + lags[:, :, -1]) / 2
    lags[:, 0] = (lags[:, 1] + lags[:, -1]) / 2
    cross = torch.fft.rfft2(lags)
    power = cross.abs()
    fy, fx = torch.fft.fftfreq(h)[:, None], torch.fft.rfftfreq(w)
    band = torch.exp(-0.5 * (fy**2 + fx**2) / 0.12**2)
    floor = 1e-3 * power.amax((1, 2), keepdim=True) + 1e-20
    return torch.fft.irfft2(band * cross / (power + floor) ** WHITEN, s=(h, w))


def peaks(surface: Tensor, turns: Tensor, factor: int, keep: int) -> Tensor:
    """The highest local maxima of `(N, A, h, w)` over lags and rotations, as motions `(N, keep, 3, 3)`."""
    h, w = surface.shape[2:]
    scaled = surface / surface.flatten(2).std(2)[..., None, None].clamp_min(1e-20)
    local = torch.where(scaled == F.max_pool2d(scaled, 5, 1, 2), scaled, -torch.inf)
    index = local.flatten(1).topk(keep).indices
    angle, row, column = index // (h * w), (index // w) % h, index % w
    motion = turns[angle].clone()
    # frame(p) = reference(turn (p + lag)): the lag is found in the turned reference's axes
    lag = torch.stack(((column + w // 2) % w - w // 2, (row + h // 2) % h - h // 2), -1).double() * factor
    motion[..., :2, 2] = (motion[..., :2, :2] @ lag[..., None])[..., 0]
    return motion
