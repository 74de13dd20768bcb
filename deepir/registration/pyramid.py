"""Band-passed copies of the frames at a scale, and sampling them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import torch
import torch.nn.functional as F
from torch import Tensor

LOW_PASS_SIGMA = 0.8  # px of the level; Gaussian low-pass of all frames
SHADING_SHRINK = 4  # factor by which frames are reduced before shading is estimated
SHADING_SIGMA = 1.5  # px of the reduced frames; shading and drift are smoother than this Gaussian


@dataclass(frozen=True)
class Level:
    """Frames averaged over `factor` x `factor` pixels.

    frames: `(N, h, w)` float32, band-passed; weight: `(h, w)`, one where they are known; whole: they are known
    everywhere; shape: the full frame's `(H, W)`.
    """

    factor: int
    frames: Tensor
    weight: Tensor
    fully_known: bool
    shape: tuple[int, int]

    def subset(self, selection: Tensor) -> Level:
        """The level of some of the frames."""
        return replace(self, frames=self.frames[selection])

    @cached_property
    def index_to_px(self) -> Tensor:
        """From indices (x, y, 1) of the level to centred px of the full frame, `(3, 3)` float64.

        Averaging drops an odd last row or column, which moves the array's centre.
        """
        f, (height, width) = self.factor, self.shape
        return torch.tensor(
            [[f, 0, (f - width) / 2], [0, f, (f - height) / 2], [0, 0, 1]], dtype=torch.float64
        )

    @cached_property
    def px_to_index(self) -> Tensor:
        """The inverse of `place`."""
        return torch.linalg.inv(self.index_to_px)

    def index_motion(self, motion: Tensor) -> Tensor:
        """Motions `(N, 3, 3)` of centred px as ones of indices, float32."""
        return (self.px_to_index @ motion @ self.index_to_px).float()

    def grid_points(self, stride: int) -> Tensor:
        """Centred px `(2, rows, columns)` of every `stride`-th pixel along each axis, without the outermost."""
        h, w = self.weight.shape
        y, x = torch.meshgrid(torch.arange(1, h - 1, stride), torch.arange(1, w - 1, stride), indexing="ij")
        index = torch.stack((x, y, torch.ones_like(x))).double()
        return torch.einsum("ij,jyx->iyx", self.index_to_px, index)[:2].float()


def gaussian_blur(images: Tensor, sigma: float) -> Tensor:
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


def smooth_shading(images: Tensor) -> Tensor:
    """The shading in `(B, h, w)`: a wide Gaussian, at a quarter of the size."""
    h, w = images.shape[-2:]
    reduced = F.avg_pool2d(images[:, None], SHADING_SHRINK, ceil_mode=True, count_include_pad=False)
    reduced = F.pad(gaussian_blur(reduced, SHADING_SIGMA), (1, 1, 1, 1), mode="replicate")
    upsampled = F.interpolate(reduced, scale_factor=SHADING_SHRINK, mode="bilinear", align_corners=False)
    return upsampled[:, 0, SHADING_SHRINK : SHADING_SHRINK + h, SHADING_SHRINK : SHADING_SHRINK + w]


def block_mean(images: Tensor, factor: int) -> Tensor:
    """Means of `(B, h, w)` over blocks of `factor` x `factor` px."""
    return images if factor == 1 else F.avg_pool2d(images[:, None], factor)[:, 0]


def build_level(frames: Tensor, weight: Tensor, factor: int) -> Level:
    """One level of flat frames `(N, H, W)` that are zero where weights `(H, W)` are.

    Filters are normalised convolutions (Knutsson & Westin 1993): single bad pixels are filled in.
    """
    known_fraction = block_mean(weight[None], factor)
    shading = smooth_shading(known_fraction).clamp_min(1e-6)
    averaged = torch.stack([block_mean(f[None], factor)[0] for f in frames])
    for frame in averaged:
        frame.sub_(known_fraction[0] * (smooth_shading(frame[None]) / shading)[0])
    support = gaussian_blur(known_fraction, LOW_PASS_SIGMA)
    known = (support > 0.5 * gaussian_blur(torch.ones_like(known_fraction), LOW_PASS_SIGMA)).float()[0]
    scale = known / support[0].clamp_min(1e-6)
    for frame in averaged:
        frame.copy_(gaussian_blur(frame, LOW_PASS_SIGMA) * scale)
    rms = float(averaged.square().mean().sqrt())
    averaged /= max(rms, 1e-12)
    return Level(factor, averaged, known, bool(known.all()), (frames.shape[1], frames.shape[2]))


def sample(images: Tensor, motion: Tensor, level: Level) -> tuple[Tensor, Tensor]:
    """Images `(1 or N, h, w)` at the level's pixels moved by `(N, 3, 3)`, and where they are known."""
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    values, known = (torch.empty(len(motion), *level.weight.shape) for _ in range(2))
    parallel_for(
        loops.pull,
        len(values[0]),
        images,
        level.weight,
        level.fully_known,
        level.index_motion(motion),
        values,
        known,
    )
    return values, known
