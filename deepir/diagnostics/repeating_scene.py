"""Whether the scene repeats itself, as fences and checkerboards do: then frames match at many displacements.

Differences of frames hold no fixed pattern, and repeat themselves as the scene does. Their autocorrelation is as high
at a period as near zero, and lower in between; along an edge or a line it stays high, and does not fall in between.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from deepir.arrays.autocorrelation import Array, autocorrelation

MAX_PAIRS = 4  # of frames whose differences are taken
#: Share of the autocorrelation one px from zero, where noise is no more, that it reaches at a period.
MIN_REPETITION = 0.8
MAX_BETWEEN = (
    0.5  # the same share, below which it falls on the way to the period; smooth scenes, as clouds, stay above
)
PEAK_REACH = 1.5  # distance of the peak of a repetition over that of its nearest sample, at most


def scene_period(frames: Array, usable: Array) -> float | None:
    """Smallest displacement at which the scene repeats itself, px; None if it does not, or by more than is seen.

    Args:
        frames: (N, h, w).
        usable: Samples that count, same shape, bool.
    """
    total, good = np.zeros((0, 0)), np.asarray(usable.all(0))
    for k in range(0, len(frames) - 1, max(1, -(-(len(frames) - 1) // MAX_PAIRS))):
        change = np.where(good, frames[k + 1].astype(float) - frames[k], 0.0)
        change[good] -= np.median(change[good]) if good.any() else 0.0
        if change.any():
            found = autocorrelation(change, change, good)
            total = total + found if total.size else found
    if not total.size:
        return None
    middle = len(total) // 2
    near = total[middle - 1 : middle + 2, middle - 1 : middle + 2]
    highest = max(near[0, 1], near[1, 0], near[0, 0], near[0, 2], 0.0)
    parts, _ = ndimage.label(total > MAX_BETWEEN * highest, np.ones((3, 3)))
    apart = np.hypot(*(np.indices(total.shape) - middle))
    other = (total > MIN_REPETITION * highest) & (parts != parts[middle, middle])
    if not other.any():
        return None
    nearest = other & (apart < PEAK_REACH * apart[other].min())  # of a ridge, the part that is nearest
    return float(apart[nearest][total[nearest].argmax()])
