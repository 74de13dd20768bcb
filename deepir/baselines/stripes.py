"""Stripes of single frames: midway equalisation, guided filters, and a trained network."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy import ndimage

from deepir import weights
from deepir.arrays.statistics import noise_in_flat_windows
from deepir.baselines.rival import Array, average_frames, correct_frames, filled_frames, normalise, rival
from deepir.burst import Burst
from deepir.config import Config
from deepir.denoisers.dct import dct
from deepir.denoisers.unet import UNet
from deepir.registry import register
from deepir.result import Result

GAUSSIAN_WIDTHS = np.arange(0.5, 8.5, 0.5)  # px; the width with the least total variation is chosen


@rival("mire", correct_frames)
def mire(frame: Array) -> Array:
    """Give neighbouring columns the same histogram, then register and average.

    Each frame is corrected by itself, along columns only, over the width with the least total variation; single pixels
    are not corrected. The response of a column need not be linear.

    Source: Y. Tendero, S. Landeau, J. Gilles: Non-uniformity correction of infrared images by midway equalization,
    Image Processing On Line 2 (2012).
    """
    return min((midway_equalise(frame, width) for width in GAUSSIAN_WIDTHS), key=total_variation)


def midway_equalise(frame: Array, width: float) -> Array:
    """Replace the quantiles of each column by their Gaussian mean over neighbouring columns: the midway histogram.

    The Gaussian has a standard deviation of `width` px. Reflection at the sides keeps the mean.
    """
    order = frame.argsort(axis=0, kind="stable")
    quantiles = np.take_along_axis(frame, order, axis=0)
    shared = ndimage.gaussian_filter1d(quantiles.astype(np.float64), width, axis=1, mode="reflect")
    result = np.empty_like(shared)
    np.put_along_axis(result, order, shared, axis=0)
    return result


def total_variation(frame: Array) -> float:
    """Sum of the absolute differences of neighbours in a frame (h, w)."""
    return float(np.abs(np.diff(frame, axis=0)).sum() + np.abs(np.diff(frame, axis=1)).sum())


@rival("admire", correct_frames)
def admire(frame: Array, *, deviation: Annotated[float, Field(gt=0)] = 32.0) -> Array:
    """Give neighbouring columns the same histogram over local widths, denoise, then register and average.

    Each frame is corrected by itself, along columns only; the response of a column need not be linear. Simplified:
    widths are those of `mire`, the total variation that selects the width of a pixel is a Gaussian mean, and the
    denoiser is `dct`, for the noise of the flattest parts of the equalised frame.

    Args:
        frame: (h, w).
        deviation: Standard deviation of that Gaussian, px.

    Source: Y. Tendero, J. Gilles: ADMIRE: a locally adaptive single-image, non-uniformity correction and denoising
    algorithm: application to uncooled IR camera, Proc. SPIE (2012), arXiv 2411.03615.
    """
    return denoise(equalise_locally(frame, deviation))


def equalise_locally(frame: Array, deviation: float) -> Array:
    """Equalise a frame (h, w), in each pixel over the width with the least total variation within `deviation` px."""
    best, least = frame, np.full(frame.shape, np.inf)
    for width in GAUSSIAN_WIDTHS:
        candidate = midway_equalise(frame, width)
        variation = local_variation(candidate, deviation)
        best = np.where(variation < least, candidate, best)
        least = np.minimum(variation, least)
    return best


def local_variation(frame: Array, deviation: float) -> Array:
    """Absolute differences of neighbours in a frame (h, w), averaged by a Gaussian of `deviation` px."""
    total = np.zeros(frame.shape)
    for axis in (0, 1):
        total += np.abs(np.diff(frame, axis=axis, append=frame.take([-1], axis)))
    return np.asarray(ndimage.gaussian_filter(total, deviation))


def denoise(frame: Array) -> Array:
    """Remove white noise from a frame (h, w); the noise level is that of its flattest parts."""
    picture = torch.from_numpy(frame.astype(np.float32))[None]
    noise = noise_in_flat_windows(picture, torch.ones_like(picture, dtype=torch.bool))
    return dct(picture, noise)[0].numpy()


@register("method", "guided_1d")
def guided_1d(
    burst: Burst,
    config: Config,
    *,
    radius: Annotated[int, Field(ge=1)] = 2,
    edge: Annotated[float, Field(gt=0)] = 0.4,
    height: Annotated[float, Field(gt=0, le=1)] = 1.0,
) -> Result:
    """Remove column stripes by guided filters along rows and columns, then register and average.

    Differences along rows below `edge` are smoothed. The part that this removes is stripes where, along a column, it is
    a linear function of the smooth frame.

    Args:
        radius: Radius of the filter along rows, px.
        edge: Differences that are smoothed, in ranges of the frames.
        height: Length of the filter along columns, in heights of the frame.

    Source: Y. Cao, M. Y. Yang, C.-L. Tisse: Effective strip noise removal for low-textured infrared images based on 1-D
    guided filtering, IEEE Trans. Circuits Syst. Video Technol. 26 (2016).
    """
    frames, low, span = normalise(filled_frames(burst))
    clean = np.stack([frame - estimate_stripes(frame, radius, edge, height) for frame in frames])
    return average_frames(burst, config, low + span * clean)


def estimate_stripes(frame: Array, radius: int, edge: float, height: float) -> Array:
    """Stripes (h, w) of a frame (h, w) with values from about zero to about one; arguments as in `guided_1d`."""
    smooth = guided_filter(frame, frame, 2 * radius + 1, edge**2, axis=1)
    return guided_filter(smooth, frame - smooth, max(3, round(height * len(frame))), edge**2, axis=0)


def guided_filter(guide: Array, image: Array, size: int, ridge: float, axis: int) -> Array:
    """The part of an image (h, w) that is linear in the guide (h, w) within a window of `size` px along an axis.

    The `ridge` regularises the slope, in squared units of the guide.

    Source: K. He, J. Sun, X. Tang: Guided image filtering, ECCV (2010).
    """

    def mean(values: Array) -> Array:
        return ndimage.uniform_filter1d(values, size, axis=axis, mode="reflect")

    level, target = mean(guide), mean(image)
    slope = (mean(guide * image) - level * target) / (mean(guide**2) - level**2 + ridge)
    return mean(slope) * guide + mean(target - slope * level)


@rival("destripe_cnn", correct_frames)
def destripe_cnn(frame: Array) -> Array:
    """Remove column stripes from each frame by a trained network, then register and average.

    The network predicts the residual and was trained on simulated columns (`deepir train destripe_cnn`). The mean of a
    frame stays. The paper's network and its training pictures are different ones.

    Source: Z. He, Y. Cao, Y. Dong, J. Yang, Y. Cao, C.-L. Tisse: Single-image-based nonuniformity correction of
    uncooled long-wave infrared detectors: a deep-learning approach, Applied Optics 57 (2018).
    """
    level = frame.mean(dtype=np.float64)
    picture = torch.from_numpy((frame - level).astype(np.float32))[None, None]
    with torch.no_grad():
        found = weights.shipped(destriping_network, "destripe_cnn").of_any_size(picture, 0.0)[0, 0].numpy()
    return np.asarray(found - found.mean() + level)


def destriping_network() -> UNet:
    """A U-net without a noise level as input."""
    return UNet((24, 48, 96))
