"""Midway equalisation over locally chosen widths, then denoising."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy import ndimage

from deepir.arrays.statistics import noise_in_flat_windows
from deepir.baselines.average import Array, average_frames, fill_invalid
from deepir.baselines.single_frame.mire import GAUSSIAN_WIDTHS, midway_equalise
from deepir.burst import Burst
from deepir.config import Config
from deepir.denoisers.dct import dct
from deepir.registry import register
from deepir.result import Result


@register("method", "admire")
def admire(burst: Burst, config: Config, *, deviation: Annotated[float, Field(gt=0)] = 32.0) -> Result:
    """Give neighbouring columns the same histogram over local widths, denoise, then register and average.

    Each frame is corrected by itself, along columns only; the response of a column need not be linear. Simplified:
    widths are those of `mire`, the total variation that selects the width of a pixel is a Gaussian mean, and the
    denoiser is `dct`, for the noise of the flattest parts of the equalised frame.

    Args:
        burst: The burst to correct.
        config: Its configuration.
        deviation: Standard deviation of that Gaussian, px.

    Source: Y. Tendero, J. Gilles: ADMIRE: a locally adaptive single-image, non-uniformity correction and denoising
    algorithm: application to uncooled IR camera, Proc. SPIE (2012), arXiv 2411.03615.
    """
    frames = fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels)
    return average_frames(
        burst, config, np.stack([denoise(equalise_locally(frame, deviation)) for frame in frames])
    )


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
