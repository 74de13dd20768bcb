"""The slow part of a pattern, and whether it is too strong to be a sensor's.

What stands still in all frames of a drive is not only the sensor's: the sky is darker above, the road brighter below.
Where the scene moves little, or shows no texture, nothing separates the two but their size. Raw patterns of
uncooled cameras have a slow part of 0.2 to 9 times the deviation of their fine part (Seek 0.2, InfiRay T2S+ 2.5, two
Lynred cameras 2.6 and 8.4), a scene that is taken for a pattern 30 to 60 times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.median_filter import median_filter

Array = np.ndarray[Any, Any]

#: Standard deviation, px, of the Gaussian below which a pattern is slow.
SLOW_SIGMA = 4.0
#: Side, px, of the windows whose median is taken off for the fine part.
FINE_SIDE = 5
#: Largest ratio of the slow part's standard deviation to the fine part's, robust, that a sensor is believed to have.
LARGEST_RATIO = 20.0


def slow_part(pattern: Array, usable: Array, sigma: float = SLOW_SIGMA) -> Array:
    """A plane and, of what it leaves of the usable pixels of a pattern (h, w), the Gaussian mean; mean zero."""
    rows, columns = np.indices(pattern.shape).astype(float) / max(pattern.shape)
    axes = np.stack((np.ones_like(rows), rows, columns), -1)
    plane = axes @ np.linalg.lstsq(axes[usable], pattern[usable], rcond=None)[0]
    share = ndimage.gaussian_filter(usable.astype(float), sigma, mode="nearest")
    mean = ndimage.gaussian_filter(np.where(usable, pattern - plane, 0.0), sigma, mode="nearest")
    slow = plane + mean / np.maximum(share, 1e-9)
    return np.asarray(slow - slow.mean())


def is_implausible(pattern: Array, usable: Array) -> bool:
    """Whether the slow part of a pattern (h, w) is stronger, by its fine part, than a sensor's."""
    detail = (pattern - median_filter(pattern, FINE_SIDE))[usable]
    fine = MAD_TO_SIGMA * float(np.median(np.abs(detail - np.median(detail)))) if usable.any() else 0.0
    return fine > 0 and float(slow_part(pattern, usable)[usable].std()) > LARGEST_RATIO * fine
