"""Midway equalisation of columns over a width that varies from place to place, then denoising."""

from __future__ import annotations

from typing import Annotated

import numpy as np
import torch
from pydantic import Field
from scipy import ndimage

from deepir.arrays.noise_level import noise_in_flat_windows
from deepir.baselines.average import Array, averaged, whole
from deepir.baselines.mire import WIDTHS, midway
from deepir.burst import Burst
from deepir.config import Config
from deepir.denoisers.dct import dct
from deepir.registry import register
from deepir.result import Result


@register("method", "admire")
def admire(burst: Burst, config: Config, *, deviation: Annotated[float, Field(gt=0)] = 32.0) -> Result:
    """Give neighbouring columns the same histogram over local widths, denoise, then register and average.

    After Y. Tendero, J. Gilles: ADMIRE: a locally adaptive single-image, non-uniformity correction and
    denoising algorithm: application to uncooled IR camera, Proc. SPIE (2012), arXiv 2411.03615. Single frame,
    columns only; a column's response need not be linear. Simplified: widths are those of `mire`; the total
    variation that chooses a pixel's width is a mean by a Gaussian of `deviation` px about it; the denoiser is
    deepir's `dct`, for the noise of the flattest parts of the equalised frame.
    """
    frames = whole(burst.frames, burst.valid & ~burst.bad_pixels)
    return averaged(burst, config, np.stack([denoised(equalised(frame, deviation)) for frame in frames]))


def equalised(frame: Array, deviation: float) -> Array:
    """A frame (h, w) equalised over the width at which the total variation about each pixel is least."""
    best, least = frame, np.full(frame.shape, np.inf)
    for width in WIDTHS:
        candidate = midway(frame, width)
        variation = local_variation(candidate, deviation)
        best = np.where(variation < least, candidate, best)
        least = np.minimum(variation, least)
    return best


def local_variation(frame: Array, deviation: float) -> Array:
    """Absolute differences of neighbours in a frame (h, w), their mean by a Gaussian of `deviation` px."""
    total = np.zeros(frame.shape)
    for axis in (0, 1):
        total += np.abs(np.diff(frame, axis=axis, append=frame.take([-1], axis)))
    return np.asarray(ndimage.gaussian_filter(total, deviation))


def denoised(frame: Array) -> Array:
    """A frame (h, w) less white noise, of the strength that its flattest parts show."""
    picture = torch.from_numpy(frame.astype(np.float32))[None]
    noise = noise_in_flat_windows(picture, torch.ones_like(picture, dtype=torch.bool))
    return dct(picture, noise)[0].numpy()
