"""Robust statistics, and the noise of frames."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.kernels.threads import is_compiled

MAX_SAMPLES_PER_FRAME = 40_000  # samples of a frame that suffice for a median or a mean
NOISE_WINDOW = 15  # side of the windows whose medians are compared, px
FLAT_WINDOW_QUANTILE = 0.1  # quantile of the windows' medians that is taken for the noise
FLAT_WINDOW_BIAS = 0.885  # that quantile in windows of pure noise, relative to the median of the noise
MAX_SAMPLES_FOR_QUANTISATION = 5000  # samples of a frame that suffice for the step between its values
ROUNDING_SIGMA = 12**-0.5  # standard deviation of a rounding error, in quantisation steps


def median(values: Tensor) -> float:
    """Median; the lower of the two middle values, as in torch; NaN for no values."""
    if not is_compiled(values) or not values.numel():
        return float(values.median())
    middle = (values.numel() - 1) // 2
    return float(np.partition(values.numpy(force=True).ravel(), middle)[middle])


def robust_std(values: Tensor) -> float:
    """Standard deviation from the median absolute deviation about the median."""
    return MAD_TO_SIGMA * median((values - median(values)).abs())


def subsample(*frames: Tensor, max_samples: int = MAX_SAMPLES_PER_FRAME) -> list[Tensor]:
    """The same regularly spaced samples (N, m) of several stacks of frames (N, C, h, w), from all columns of the image.

    About `max_samples` of a frame are kept.
    """
    *_, height, width = frames[0].shape
    stride = max(1, height * width // max_samples)
    while math.gcd(stride, width) > 1:  # a common factor would visit the same columns only
        stride += 1
    return [each.flatten(1)[:, ::stride] for each in frames]


def masked_values(values: Tensor, mask: Tensor) -> Tensor:
    """`values[mask]`, (K,); by numpy on the CPU, which is ten times as fast as torch."""
    if not is_compiled(values):
        return values[mask]
    return torch.from_numpy(values.numpy()[mask.numpy()])


def sample_noise(frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of the noise of a sample of frames (N, h, w), from mixed second differences.

    Consecutive frames are subtracted first, which removes a fixed pattern; a single frame is used as it is. The median
    leaves out smooth regions and edges of the scene, but not fine texture: the result is an upper bound. Samples that
    are `usable`, (N, h, w) bool, count; zero without any.
    """
    if len(frames) > 1:
        frames, usable = (frames[1:] - frames[:-1]) / 2**0.5, usable[1:] & usable[:-1]
    some, counts = subsample(*(each[:, None] for each in mixed_difference(frames, usable)))
    found = masked_values(some, counts).abs()
    return MAD_TO_SIGMA * median(found) if found.numel() else 0.0


def noise_in_flat_windows(frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of the noise of a sample, from the flattest windows; for frames of different scenes.

    Of frames (N, h, w) without a fixed pattern, and samples that are `usable`, same shape, bool; zero without a window.
    """
    found = []
    for k in range(len(frames)):
        fine, whole = mixed_difference(frames[k : k + 1], usable[k : k + 1])
        fine = fine.abs().where(whole, torch.nan)[0]
        windows = fine.unfold(0, NOISE_WINDOW, NOISE_WINDOW).unfold(1, NOISE_WINDOW, NOISE_WINDOW).flatten(2)
        found.append(windows.nanmedian(2).values.flatten())
    each = torch.cat(found)
    each = each[each.isfinite()]
    return float(MAD_TO_SIGMA * each.quantile(FLAT_WINDOW_QUANTILE) / FLAT_WINDOW_BIAS) if len(each) else 0.0


def mixed_difference(frames: Tensor, usable: Tensor) -> tuple[Tensor, Tensor]:
    """Mixed second differences (N, h - 1, w - 1) of frames along both axes, scaled to the variance of the noise.

    And where all four samples of one are usable, bool, same shape.
    """
    fine = (frames[:, 1:, 1:] - frames[:, 1:, :-1] - frames[:, :-1, 1:] + frames[:, :-1, :-1]) / 2
    whole = usable[:, 1:, 1:] & usable[:, 1:, :-1] & usable[:, :-1, 1:] & usable[:, :-1, :-1]
    return fine, whole


def quantisation_step(frames: Tensor, usable: Tensor) -> float:
    """Quantisation step of usable samples: the lower quartile of the differences of consecutive distinct values.

    Of frames (N, 1, h, w), in their units; zero for constant frames.
    """
    some, counts = subsample(frames, usable, max_samples=MAX_SAMPLES_FOR_QUANTISATION)
    apart = some[counts].unique().diff()
    return float(apart.quantile(0.25)) if len(apart) else 0.0


def median_sigma(precision: Tensor) -> float:
    """Median standard deviation of the samples, from their precisions (N, C, h, w); NaN if all are zero."""
    (some,) = subsample(precision, max_samples=MAX_SAMPLES_PER_FRAME // len(precision))
    return median(masked_values(some, some > 0)) ** -0.5
