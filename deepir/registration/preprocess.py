"""Frames prepared for registration, at several resolutions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.ndimage
import scipy.optimize
import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.arrays.statistics import subsample
from deepir.arrays.windows import median_filter

MIN_RELATIVE_FLUX = 0.05  # of the median; smaller values are raised to it before the logarithm
MAX_NONPOSITIVE_FRACTION = 0.05  # of the samples; with more, frames are no flux and no logarithm is taken
LOW_PASS_SIGMA = 0.8  # px of the level; Gaussian low-pass of all frames
SHADING_SHRINK = 4  # factor by which frames are reduced before shading is estimated
SHADING_SIGMA = 1.5  # px of the reduced frames; shading and drift are smoother than this Gaussian


def preprocess(frames: Tensor, ignore: Tensor | None) -> tuple[Tensor, Tensor]:
    """Frames `(N, H, W)` float32, zero where the weight is zero, and that weight `(H, W)`, zero or one.

    Takes the logarithm, masks bad and stuck pixels; of fewer than three frames, subtracts stripes, too. Three and more
    frames keep their stripes, as part of the fixed pattern.

    Args:
        frames: `(N, H, W)`, any unit; NaN or infinite where a pixel is bad.
        ignore: `(H, W)` bool, True where a pixel must not be used.
    """
    good = torch.ones(frames.shape[1:], dtype=torch.bool)
    for frame in frames:
        good &= frame.isfinite()
    if ignore is not None:
        good &= ~ignore
    if not good.any():
        return torch.zeros(frames.shape), good.float()
    y = log_or_centre(frames, good)
    mean = y.mean(0)
    lines = line_pattern(mean, 0) + line_pattern(mean, 1)
    good &= ~stuck_pixels(mean - lines)
    if len(frames) < 3:
        y -= lines
    return y.mul_(good), good.float()


def log_or_centre(frames: Tensor, good: Tensor) -> Tensor:
    """Logarithm of the frames over their median, so that gains become offsets; minus the median if not positive.

    Pixels that are not `good`, `(H, W)` bool, are set to the median.
    """
    values, known = subsample(frames, good.expand_as(frames))
    known_values = values[known]
    centre = float(known_values.median())
    positive = centre > 0 and float((known_values <= 0).double().mean()) <= MAX_NONPOSITIVE_FRACTION
    y = torch.empty(frames.shape)
    for frame, out in zip(frames, y, strict=True):
        out.copy_(frame).masked_fill_(~good, centre)
        if positive:
            out.div_(centre).clamp_min_(MIN_RELATIVE_FLUX).log_()
        else:
            out.sub_(centre)
    return y


def line_pattern(image: Tensor, axis: int) -> Tensor:
    """Offset of each line along `axis`: median, along it, of the difference from a moving average across the lines.

    Of an image `(H, W)` they are `(1, W)` for columns (axis 0), `(H, 1)` for rows. What is broader is no stripe.
    """
    moving_average = scipy.ndimage.uniform_filter1d(image.numpy(), 31, axis=1 - axis, mode="nearest")  # px
    return (image - torch.from_numpy(moving_average)).median(axis, keepdim=True).values


def stuck_pixels(image: Tensor) -> Tensor:
    """Pixels `(H, W)` bool that differ from their 3 x 3 median by ten robust standard deviations."""
    deviation = (image - median_filter(image[None, None])[0, 0]).abs()
    scale = MAD_TO_SIGMA * float(subsample(deviation[None])[0].median())
    return deviation > (10 * scale or torch.inf)


def variance_stabilise(frames: Tensor, weight: Tensor) -> Tensor:
    """Transform the flux so that the variance of the fixed pattern does not depend on it; fill bad pixels.

    Gains of variance `a` and offsets of variance `b` are a pattern of variance `a z^2 + b` at flux `z`. In
    `asinh(z / k)`, with `k^2 = b / a`, its variance is constant: a logarithm where gains dominate, linear where offsets
    do. Pixels with a weight `(h, w)` other than one are filled. The result is float64.

    Source: Bartlett, The use of transformations, Biometrics 3 (1947).
    """
    frames = fill_bad_pixels(frames, weight == 1)
    return (frames / asinh_scale(frames.mean(0).numpy())).asinh()


def fill_bad_pixels(frames: Tensor, good: Tensor) -> Tensor:
    """Fill bad pixels with the mean of the good ones, `(h, w)` bool, in the smallest window that holds enough of them.

    Each next window is about twice as wide. Returns frames `(N, h, w)` float64; zero if no pixel is good.
    """
    filled, unknown, window = torch.where(good, frames.double(), 0.0), ~good, 5  # px
    known, fraction = filled.numpy(), good.double().numpy()
    while unknown.any() and good.any():
        local_fraction = scipy.ndimage.uniform_filter(fraction, window, mode="constant")
        local_sum = scipy.ndimage.uniform_filter(known, (0, window, window), mode="constant")
        least = 0.03 if window < max(good.shape) else 1e-9  # of the window; at last any pixel, but no rounding
        fillable = unknown & torch.from_numpy(local_fraction > least)
        filled = torch.where(fillable, torch.from_numpy(local_sum / local_fraction.clip(least)), filled)
        unknown, window = unknown & ~fillable, 2 * window + 1
    return filled


def asinh_scale(image: np.ndarray) -> float:
    """Flux at which gains and offsets contribute equally to the pattern: scale `k` of the asinh transform.

    The variance of an image `(h, w)`, the mean of the frames, about its local mean is fitted by `a z^2 + b` over
    quantile bins of the flux `z`, with weights of one over its square, `a` and `b` not negative. The scale is
    `sqrt(b / a)`, in units of the image, bounded between a nearly logarithmic and a nearly linear transform.
    """
    local_mean = scipy.ndimage.uniform_filter(image, 7, mode="nearest")  # px
    rms = float(np.sqrt(np.mean(local_mean**2))) or 1.0
    bins = np.array_split(local_mean.ravel().argsort(), 8)
    flux, deviation = local_mean.ravel() / rms, np.abs(image - local_mean).ravel() / rms
    mean_square = np.array([np.mean(flux[pixels] ** 2) for pixels in bins])
    pattern_power = np.array([np.median(deviation[pixels]) ** 2 for pixels in bins]).clip(1e-20)
    terms = np.stack((1 / pattern_power, mean_square / pattern_power), 1)
    (offset, gain), _ = scipy.optimize.nnls(terms, np.ones(len(bins)))
    return rms * float(np.clip(np.sqrt(offset / max(gain, 1e-20)), 0.05, 50.0))  # root mean squares of the flux


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
        return torch.tensor([[f, 0, (f - width) / 2], [0, f, (f - height) / 2], [0, 0, 1]], dtype=torch.float64)

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
    """Gaussian blur of images `(..., h, w)`, zero outside of them, by a standard deviation in px.

    The kernel is cut at three sigma. Shifted sums are fast for its few taps.
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
    """Build one level: block means over `factor` px, shading subtracted, low-passed, of root mean square one.

    The filters are normalised convolutions, which fill isolated bad pixels from their neighbours. Of preprocessed
    frames `(N, H, W)`, zero where the weight `(H, W)` is, which is zero where a pixel is bad, else one.

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
    """Values `(N, h, w)` of images at the level's pixels, moved by each motion, and where they are known, one or zero.

    By bilinear interpolation; values are zero where unknown.

    Args:
        images: `(N, h, w)`, one per motion, or `(1, h, w)`, the same for all motions.
        motion: `(N, 3, 3)`, in centred px of the full frame.
        level: grid and weight of the images.
    """
    from deepir.kernels import registration as loops
    from deepir.kernels.compile import parallel_for

    values, known = (torch.empty(len(motion), *level.weight.shape) for _ in range(2))
    given = images, level.weight, level.fully_known, level.index_motion(motion)
    parallel_for(loops.sample_images, len(values[0]), *given, values, known)
    return values, known
