"""Levels of an image pyramid: band-passed block means of the frames, and their interpolation at moved points."""

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
    """One level of the pyramid: block means over `factor` x `factor` pixels, band-passed.

    factor: px of the full frame per px of the level. frames: `(N, h, w)` float32, root mean square one. weight:
    `(h, w)`, one where the frames are known, else zero. fully_known: True if the weight is one everywhere. shape:
    `(H, W)` of the full frame, px.
    """

    factor: int
    frames: Tensor
    weight: Tensor
    fully_known: bool
    shape: tuple[int, int]

    def subset(self, selection: Tensor) -> Level:
        """The level of the selected frames: a `(N,)` bool mask or indices."""
        return replace(self, frames=self.frames[selection])

    @cached_property
    def index_to_px(self) -> Tensor:
        """Matrix `(3, 3)` float64 from array indices (x, y, 1) of the level to centred px of the full frame.

        Block means drop an incomplete last row or column, which shifts the centre of the array.
        """
        f, (height, width) = self.factor, self.shape
        return torch.tensor(
            [[f, 0, (f - width) / 2], [0, f, (f - height) / 2], [0, 0, 1]], dtype=torch.float64
        )

    @cached_property
    def px_to_index(self) -> Tensor:
        """Matrix `(3, 3)` float64 from centred px of the full frame to array indices of the level."""
        return torch.linalg.inv(self.index_to_px)

    def index_motion(self, motion: Tensor) -> Tensor:
        """Motions `(N, 3, 3)` in centred px, converted to array indices of the level, float32."""
        return (self.px_to_index @ motion @ self.index_to_px).float()

    def grid_points(self, stride: int) -> Tensor:
        """Centred px `(2, rows, columns)`, x and y, of every `stride`-th pixel of the level's interior."""
        h, w = self.weight.shape
        y, x = torch.meshgrid(torch.arange(1, h - 1, stride), torch.arange(1, w - 1, stride), indexing="ij")
        index = torch.stack((x, y, torch.ones_like(x))).double()
        return torch.einsum("ij,jyx->iyx", self.index_to_px, index)[:2].float()


def gaussian_blur(images: Tensor, sigma: float) -> Tensor:
    """Gaussian blur, zero outside the images.

    The kernel is cut at three sigma. Shifted sums are fast for its few taps.

    Args:
        images: `(..., h, w)`.
        sigma: standard deviation, px.
    """
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
    """Low-pass `(B, h, w)` of images: shading and drift. Computed on reduced images, then upsampled bilinearly."""
    h, w = images.shape[-2:]
    reduced = F.avg_pool2d(images[:, None], SHADING_SHRINK, ceil_mode=True, count_include_pad=False)
    reduced = F.pad(gaussian_blur(reduced, SHADING_SIGMA), (1, 1, 1, 1), mode="replicate")
    upsampled = F.interpolate(reduced, scale_factor=SHADING_SHRINK, mode="bilinear", align_corners=False)
    return upsampled[:, 0, SHADING_SHRINK : SHADING_SHRINK + h, SHADING_SHRINK : SHADING_SHRINK + w]


def block_mean(images: Tensor, factor: int) -> Tensor:
    """Means `(B, h / factor, w / factor)` of images `(B, h, w)` over blocks of `factor` x `factor` px."""
    return images if factor == 1 else F.avg_pool2d(images[:, None], factor)[:, 0]


def build_level(frames: Tensor, weight: Tensor, factor: int) -> Level:
    """Build one level: block means, shading subtracted, low-passed, normalised to root mean square one.

    The filters are normalised convolutions, which fill isolated bad pixels from their neighbours.

    Args:
        frames: `(N, H, W)`, preprocessed; zero where the weight is zero.
        weight: `(H, W)`, zero where a pixel is bad, else one.
        factor: side of the blocks, px.

    Source: Knutsson and Westin, Normalized and differential convolution, CVPR 1993.
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
    """Interpolate images bilinearly at the level's pixels, moved by each motion.

    Args:
        images: `(N, h, w)`, one per motion, or `(1, h, w)`, the same for all motions.
        motion: `(N, 3, 3)`, in centred px of the full frame.
        level: grid and weight of the images.

    Returns:
        The values `(N, h, w)`, zero where unknown, and where they are known `(N, h, w)`, one or zero.
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    values, known = (torch.empty(len(motion), *level.weight.shape) for _ in range(2))
    index_motion = level.index_motion(motion)
    parallel_for(
        loops.sample_images,
        len(values[0]),
        images,
        level.weight,
        level.fully_known,
        index_motion,
        values,
        known,
    )
    return values, known
