"""Column stripes by one-dimensional guided filters, frame by frame."""

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
    """Remove column stripes by guided filters along rows and columns, then register and average.

    Differences along rows below `edge` are smoothed. The part that this removes is stripes where, along a column, it is
    a linear function of the smooth frame.

    Args:
        burst: The burst to correct.
        config: Its configuration.
        radius: Radius of the filter along rows, px.
        edge: Differences that are smoothed, in ranges of the frames.
        height: Length of the filter along columns, in heights of the frame.

    Source: Y. Cao, M. Y. Yang, C.-L. Tisse: Effective strip noise removal for low-textured infrared images based on 1-D
    guided filtering, IEEE Trans. Circuits Syst. Video Technol. 26 (2016).
    """
    frames, low, span = normalise(fill_invalid(burst.frames, burst.valid & ~burst.bad_pixels))
    clean = np.stack([frame - estimate_stripes(frame, radius, edge, height) for frame in frames])
    return average_frames(burst, config, low + span * clean)


def estimate_stripes(frame: Array, radius: int, edge: float, height: float) -> Array:
    """Stripes (h, w) of a frame (h, w) with values from about zero to about one; arguments as in `guided_1d`."""
    smooth = guided_filter(frame, frame, 2 * radius + 1, edge**2, axis=1)
    return guided_filter(smooth, frame - smooth, max(3, round(height * len(frame))), edge**2, axis=0)


def guided_filter(guide: Array, image: Array, size: int, ridge: float, axis: int) -> Array:
    """The part of an image that is linear in the guide within a window along an axis.

    Args:
        guide: (h, w).
        image: (h, w).
        size: Length of the window, px.
        ridge: Regularisation of the slope, squared units of the guide.
        axis: 0 along columns, 1 along rows.

    Returns:
        (h, w).

    Source: K. He, J. Sun, X. Tang: Guided image filtering, ECCV (2010).
    """

    def mean(values: Array) -> Array:
        return ndimage.uniform_filter1d(values, size, axis=axis, mode="reflect")

    level, target = mean(guide), mean(image)
    slope = (mean(guide * image) - level * target) / (mean(guide**2) - level**2 + ridge)
    return mean(slope) * guide + mean(target - slope * level)
