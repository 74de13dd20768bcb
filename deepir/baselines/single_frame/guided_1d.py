"""Stripes are what is left of smooth rows, and goes with the scene along a column: frame by frame."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy import ndimage

from deepir.baselines.average import Array, average_frames, fill_invalid
from deepir.baselines.online import normalise
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result


@register("method", "guided_1d")
def guided_1d(
    burst: Burst,
    config: Config,
    *,
    radius: Annotated[int, Field(ge=1)] = 2,
    edge: Annotated[float, Field(gt=0)] = 0.4,
    height: Annotated[float, Field(gt=0, le=1)] = 1.0,
) -> Result:
    """Take column stripes away by guided filters along rows and columns, then register and average.

    Y. Cao, M. Y. Yang, C.-L. Tisse: Effective strip noise removal for low-textured infrared images based on 1-D guided
    filtering, IEEE Trans. Circuits Syst. Video Technol. 26 (2016). Differences along rows below `edge` of the range are
    smoothed over `radius` px; what that takes is stripes where it is a linear function of the smooth frame within
    `height` of a column.
    """
    frames, low, span = normalise(fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels))
    clean = np.stack([frame - estimate_stripes(frame, radius, edge, height) for frame in frames])
    return average_frames(burst, config, low + span * clean)


def estimate_stripes(frame: Array, radius: int, edge: float, height: float) -> Array:
    """The stripes of a frame (h, w) that reaches from about zero to about one."""
    smooth = guided_filter(frame, frame, 2 * radius + 1, edge**2, axis=1)
    return guided_filter(smooth, frame - smooth, max(3, round(height * len(frame))), edge**2, axis=0)


def guided_filter(guide: Array, image: Array, size: int, ridge: float, axis: int) -> Array:
    """What of an image is linear in the guide over windows of `size` px along an axis (He, Sun, Tang 2010)."""

    def mean(values: Array) -> Array:
        return ndimage.uniform_filter1d(values, size, axis=axis, mode="reflect")

    level, target = mean(guide), mean(image)
    slope = (mean(guide * image) - level * target) / (mean(guide**2) - level**2 + ridge)
    return mean(slope) * guide + mean(target - slope * level)
