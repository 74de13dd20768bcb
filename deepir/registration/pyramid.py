"""Band-passed copies of the frames at several scales, and sampling them at points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.registration.motion import pixel_grid

FINEST, COARSEST = 0.8, 1.5  # px of the level: the range of the low-pass, chosen from the spectrum
BROAD = 6.0  # px of the level: shading and drift are broader


@dataclass(frozen=True)
class Level:
    """Frames averaged over `factor` x `factor` pixels.

    flat: `(N, h, w)` float32, averaged only; frames: the same, band-passed between Gaussians of `fine` and
    `BROAD` px; weight: `(h, w)`, one where good; shape: the full frame's `(H, W)`.
    """

    factor: int
    flat: Tensor
    frames: Tensor
    weight: Tensor
    fine: float
    shape: tuple[int, int]

    def points(self) -> Tensor:
        """Full-frame centred points `(2, h w)` of the level's pixels.

        Averaging drops an odd last row or column, which moves the array's centre.
        """
        h, w = self.weight.shape
        centre = [(w * self.factor - self.shape[1]) / 2, (h * self.factor - self.shape[0]) / 2]
        return pixel_grid(h, w) * self.factor + torch.tensor(centre)[:, None]


def gaussian(sigma: float) -> Tensor:
    """A normalised 1-D Gaussian kernel cut at three sigma."""
    radius = math.ceil(3 * sigma)
    x = torch.arange(-radius, radius + 1, dtype=torch.float32)
    kernel = torch.exp(-0.5 * (x / sigma) ** 2)
    return kernel / kernel.sum()


def blur(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of `(N, h, w)`, zero outside."""
    kernel = gaussian(sigma)
    radius = len(kernel) // 2
    rows = F.conv2d(images[:, None], kernel.view(1, 1, 1, -1), padding=(0, radius))
    return F.conv2d(rows, kernel.view(1, 1, -1, 1), padding=(radius, 0))[:, 0]


def smooth(images: Tensor, weight: Tensor, sigma: float) -> Tensor:
    """Local mean of `(N, h, w)` under weights `(h, w)`: normalised convolution (Knutsson & Westin 1993)."""
    return blur(images * weight, sigma) / blur(weight[None], sigma).clamp_min(1e-6)


def average(images: Tensor, weight: Tensor, factor: int) -> tuple[Tensor, Tensor]:
    """Weighted mean over blocks of `factor` x `factor` px; a block's weight is its share of good pixels."""
    if factor == 1:
        return images, weight
    share = F.avg_pool2d(weight[None, None], factor)[0, 0]
    pooled = F.avg_pool2d((images * weight)[:, None], factor)[:, 0]
    return pooled / share.clamp_min(1e-6), share


def low_pass(images: Tensor) -> float:
    """The Gaussian (sigma in px) that passes the frequencies where the scene stands above what is white.

    What is white is the spectrum's tail: noise and pixel pattern. The Gaussian halves the amplitude where the
    Wiener filter does: where the radial power is twice the tail's. images: `(N, h, w)`.
    """
    h, w = images.shape[1:]
    window = torch.hann_window(h)[:, None] * torch.hann_window(w)
    power = torch.fft.rfft2(images[:4] * window).abs().square().mean(0)
    radius = (torch.fft.fftfreq(h)[:, None].square() + torch.fft.rfftfreq(w).square()).sqrt()
    ring = (radius * 32).round().long().clamp_max(16).flatten()
    total = torch.zeros(17).index_add_(0, ring, power.flatten()) / torch.bincount(
        ring, minlength=17
    ).clamp_min(1)
    clear = total[:-2] > 2 * total[-3:].mean()
    cutoff = int(clear.long().cumprod(0).sum()) / 32
    return min(max(0.187 / max(cutoff, 1e-3), FINEST), COARSEST)


def build_level(frames: Tensor, weight: Tensor, factor: int) -> Level:
    """One level of the pyramid from flat frames `(N, H, W)` and weights `(H, W)`."""
    pooled, share = average(frames, weight, factor)
    good = (share >= 0.5).float()
    broad = smooth(pooled, good, BROAD)
    flat = (pooled - broad) * good
    fine = low_pass(flat)
    band = (smooth(pooled, good, fine) - broad) * good
    return Level(factor, flat, band, good, fine, (frames.shape[1], frames.shape[2]))


def pattern_share(level: Level) -> Tensor:
    """How much `(N,)` the fixed pattern adds to each band-passed frame's correlation with frame 0 where
    nothing moved.

    A pattern correlates at lag zero only, a scene is smooth there: the excess over the value extrapolated
    from one and two pixels' lag, `(4 C1 - C2) / 3`, is the pattern's.
    """
    mean = [lagged(level.flat, lag) for lag in (0, 1, 2)]
    excess = (mean[0] - (4 * mean[1] - mean[2]) / 3).clamp_min(0)
    size = 6 * math.ceil(BROAD) + 1
    spike = torch.zeros(1, size, size)
    spike[0, size // 2, size // 2] = 1
    passed = (blur(spike, level.fine) - blur(spike, BROAD)).square().sum()
    spread = level.frames.square().mean((1, 2)).sqrt()
    return excess * passed / (spread[0] * spread).clamp_min(1e-12)


def lagged(frames: Tensor, lag: int) -> Tensor:
    """Mean product `(N,)` of frame 0 and each frame, `lag` px apart in the four directions."""
    first = frames[0]
    if lag == 0:
        return (first * frames).mean((1, 2))
    pairs = [
        first[:, lag:] * frames[:, :, :-lag],
        first[:, :-lag] * frames[:, :, lag:],
        first[lag:] * frames[:, :-lag],
        first[:-lag] * frames[:, lag:],
    ]
    return torch.stack([pair.mean((1, 2)) for pair in pairs]).mean(0)


def sample(images: Tensor, points: Tensor, level: Level) -> Tensor:
    """Values `(B, C, M)` of level images `(B, C, h, w)` at centred points `(B, 2, M)`; zero outside."""
    full = torch.tensor(level.shape[::-1])[:, None]
    size = torch.tensor(images.shape[:1:-1])[:, None]
    index = (points + (full - level.factor) / 2) / level.factor
    index = straightened(index.clamp(-2.0, 2.0 * max(images.shape[-2:])).nan_to_num(-2.0))
    unit = ((2 * index + 1) / size - 1).transpose(1, 2)[:, None]
    return F.grid_sample(images, unit, mode="bicubic", padding_mode="zeros", align_corners=False)[:, :, 0]


def straightened(index: Tensor) -> Tensor:
    """Indices at which torch's bicubic interpolation returns a ramp's value at `index`.

    Its kernel (Keys 1981 with a = -0.75) does not reproduce a ramp: at `u` from the middle of two samples it
    returns the value at `t = 0.75 u + u^3`, up to 0.05 px off, which pulls motions to whole pixels. The
    inverse, `sinh(asinh(4 t) / 3)`, is taken as a polynomial that is right to 5e-4 px and continuous between
    pixels.
    """
    middle = index.floor() + 0.5
    t = index - middle
    square = t * t
    return middle + t * (1 + (0.25 - square) * (1.2987 + square * (-4.9444 + 10.8179 * square)))
