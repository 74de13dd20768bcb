"""The low-order part of a pattern, and whether it is too strong to be a sensor's.

What stands still in all frames of a drive is not only the sensor's: the sky is darker above, the road brighter below.
Where the scene moves little, or shows no texture, nothing separates the two but their size. In raw patterns of uncooled
cameras the deviation of the low-order part is 0.2 to 9 times that of the fine part (Seek 0.2, InfiRay T2S+ 2.5, two
Lynred cameras 2.6 and 8.4). In a scene that is taken for a pattern it is 30 to 60 times.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import ndimage

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.median_filter import median_filter

Array = np.ndarray[Any, Any]

#: Standard deviation, px, of the Gaussian that takes the low-order part.
LOW_ORDER_SIGMA = 4.0
#: Side, px, of the windows whose median is taken off for the fine part.
FINE_SIDE = 5
#: Largest ratio of the low-order part's standard deviation to the fine part's (robust) in a sensor's pattern.
MAX_RATIO = 20.0


def low_order_part(pattern: Array, usable: Array, sigma: float = LOW_ORDER_SIGMA) -> Array:
    """A plane and, of what it leaves of the usable pixels of a pattern (h, w), the Gaussian mean; mean zero."""
    rows, columns = np.indices(pattern.shape).astype(float) / max(pattern.shape)
    axes = np.stack((np.ones_like(rows), rows, columns), -1)
    plane = axes @ np.linalg.lstsq(axes[usable], pattern[usable], rcond=None)[0]
    share = ndimage.gaussian_filter(usable.astype(float), sigma, mode="nearest")
    mean = ndimage.gaussian_filter(np.where(usable, pattern - plane, 0.0), sigma, mode="nearest")
    low_order = plane + mean / np.maximum(share, 1e-9)
    return np.asarray(low_order - low_order.mean())


def is_implausible(pattern: Array, usable: Array) -> bool:
    """Whether the low-order part of a pattern (h, w) is stronger, by its fine part, than a sensor's."""
    detail = (pattern - median_filter(pattern, FINE_SIDE))[usable]
    fine = MAD_TO_SIGMA * float(np.median(np.abs(detail - np.median(detail)))) if usable.any() else 0.0
    return fine > 0 and float(low_order_part(pattern, usable)[usable].std()) > MAX_RATIO * fine
