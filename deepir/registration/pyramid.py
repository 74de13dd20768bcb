"""Band-passed copies of the frames at a scale, and sampling them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

FINE = 0.8  # px of the level: Gaussian low-pass
SHRINK, BROAD = 4, 1.5  # shading and drift are broader than a Gaussian of BROAD px after shrinking


@dataclass(frozen=True)
class Level:
    """Frames averaged over `factor` x `factor` pixels.

    frames: `(N, h, w)` float32, band-passed; weight: `(h, w)`, one where they are known; whole: they are known
    everywhere; shape: the full frame's `(H, W)`.
    """

    factor: int
    frames: Tensor
    weight: Tensor
    whole: bool
    shape: tuple[int, int]

    def of(self, some: Tensor) -> Level:
        """The level of some of the frames."""
        return replace(self, frames=self.frames[some])

    @cached_property
    def place(self) -> Tensor:
        """From indices (x, y, 1) of the level to centred px of the full frame, `(3, 3)` float64.

        Averaging drops an odd last row or column, which moves the array's centre.
        """
        f, (height, width) = self.factor, self.shape
        return torch.tensor(
            [[f, 0, (f - width) / 2], [0, f, (f - height) / 2], [0, 0, 1]], dtype=torch.float64
        )

    @cached_property
    def index(self) -> Tensor:
        """The inverse of `place`."""
        return torch.linalg.inv(self.place)

    def indexed(self, motion: Tensor) -> Tensor:
        """Motions `(N, 3, 3)` of centred px as ones of indices, float32."""
        return (self.index @ motion @ self.place).float()

    def points(self, stride: int) -> Tensor:
        """Centred px `(2, rows, columns)` of every `stride`-th pixel along each axis, without the outermost."""
        h, w = self.weight.shape
        y, x = torch.meshgrid(torch.arange(1, h - 1, stride), torch.arange(1, w - 1, stride), indexing="ij")
        index = torch.stack((x, y, torch.ones_like(x))).double()
        return torch.einsum("ij,jyx->iyx", self.place, index)[:2].float()


def smooth(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur of `(..., h, w)`, cut at three sigma, zero outside; by shifted sums, for few taps."""
    radius = math.ceil(3 * sigma)
    kernel = [math.exp(-0.5 * (x / sigma) ** 2) for x in range(radius + 1)]
    total = kernel[0] + 2 * sum(kernel[1:])
    for axis in (-1, -2):
        side = images.shape[axis]
        padded = F.pad(images, (radius, radius, 0, 0) if axis == -1 else (0, 0, radius, radius))
        images = images * (kernel[0] / total)
        for x in range(1, radius + 1):
            images.add_(padded.narrow(axis, radius - x, side), alpha=kernel[x] / total)
            images.add_(padded.narrow(axis, radius + x, side), alpha=kernel[x] / total)
    return images


def broad(images: Tensor) -> Tensor:
    """The shading in `(B, h, w)`: a wide Gaussian, at a quarter of the size."""
    h, w = images.shape[-2:]
    small = F.avg_pool2d(images[:, None], SHRINK, ceil_mode=True, count_include_pad=False)
    small = F.pad(smooth(small, BROAD), (1, 1, 1, 1), mode="replicate")
    up = F.interpolate(small, scale_factor=SHRINK, mode="bilinear", align_corners=False)
    return up[:, 0, SHRINK : SHRINK + h, SHRINK : SHRINK + w]


def average(images: Tensor, factor: int) -> Tensor:
    """Means of `(B, h, w)` over blocks of `factor` x `factor` px."""
    return images if factor == 1 else F.avg_pool2d(images[:, None], factor)[:, 0]


def build_level(frames: Tensor, weight: Tensor, factor: int) -> Level:
    """One level of flat frames `(N, H, W)` that are zero where weights `(H, W)` are.

    Filters are normalised convolutions (Knutsson & Westin 1993): single bad pixels are filled in.
    """
    share = average(weight[None], factor)
    shading = broad(share).clamp_min(1e-6)
    flat = torch.stack([average(f[None], factor)[0] for f in frames])
    for frame in flat:
        frame.sub_(share[0] * (broad(frame[None]) / shading)[0])
    support = smooth(share, FINE)
    known = (support > 0.5 * smooth(torch.ones_like(share), FINE)).float()[0]
    scale = known / support[0].clamp_min(1e-6)
    for frame in flat:
        frame.copy_(smooth(frame, FINE) * scale)
    parallel_for = float(flat.square().mean().sqrt())
    flat /= max(parallel_for, 1e-12)
    return Level(factor, flat, known, bool(known.all()), (frames.shape[1], frames.shape[2]))


def sample(images: Tensor, motion: Tensor, level: Level) -> tuple[Tensor, Tensor]:
    """Images `(1 or N, h, w)` at the level's pixels moved by `(N, 3, 3)`, and where they are known."""
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    values, known = (torch.empty(len(motion), *level.weight.shape) for _ in range(2))
    parallel_for(
        loops.sample_images,
        len(values[0]),
        images,
        level.weight,
        level.whole,
        level.indexed(motion),
        values,
        known,
    )
    return values, known
