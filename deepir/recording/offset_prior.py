"""The prior of a sensor's pattern: independent cosine modes, whose variances the data give.

One Gaussian holds the pattern at all scales. The variance of a mode depends on its period alone, and is larger where
the mode is a column or a row: rows and columns share electronics.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import fft

from deepir.arrays.statistics import CHI_SQUARED_MEDIAN

Array = np.ndarray[Any, Any]

PSEUDO_COUNT = 2.0  # modes that the variance of a band so far counts as
#: Modes of a period longer than this, in px, start with a variance that grows with the square of the period.
WHITE_PERIOD = 8.0


def dct(values: Array) -> Array:
    """Orthonormal cosine transform over the last two axes."""
    return np.asarray(fft.dctn(values, norm="ortho", axes=(-2, -1)))


def idct(modes: Array) -> Array:
    """Its inverse."""
    return np.asarray(fft.idctn(modes, norm="ortho", axes=(-2, -1)))


def mode_radius(size: Sequence[int]) -> Array:
    """Half periods of each cosine mode over the longer side of a frame (h, w)."""
    down, across = (np.arange(side) * max(size) / side for side in size)
    return np.hypot(down[:, None], across)


class PatternPrior:
    """Variances of the cosine modes of a pattern (h, w), estimated by expectation maximisation.

    Args:
        size: (h, w), px.
        pixel_variance: of the finest modes, to start from, squared units of the pattern.

    Attributes:
        start: (h, w), variance of each mode before the data; of the mean next to nothing, which no data determine.
        variance: (h, w), of each mode.
    """

    def __init__(self, size: Sequence[int], pixel_variance: float) -> None:
        self.groups = mode_groups(size)
        radius = mode_radius(size)
        growth = np.maximum(1, (2 * max(size) / WHITE_PERIOD / np.maximum(radius, 1)) ** 2)
        self.start = pixel_variance * growth
        self.start[0, 0] = 1e-9 * pixel_variance
        self.variance = self.start.copy()

    @classmethod
    def of_finest(cls, modes: Array) -> PatternPrior:
        """To start from the finest of the modes (h, w) of a pattern: the others continue their spectrum."""
        finest = modes[mode_radius(modes.shape) > max(modes.shape) / 2]
        return cls(modes.shape, max(float(np.median(finest**2)) / CHI_SQUARED_MEDIAN, 1e-12))

    def update(self, modes: Array, posterior: Array, among: Array) -> None:
        """Set the variances of the modes in a mask (h, w) by `strengths`."""
        self.variance[among] = self.strengths(modes, posterior, among)

    def strengths(self, modes: Array, posterior: Array, among: Array) -> Array:
        """Variances of modes in a mask (h, w), by the means and posterior variances (h, w) of those of their group."""
        groups, start = self.groups[among], self.start[among]
        most = int(self.groups.max()) + 1
        known = np.bincount(groups, minlength=most)
        power = np.bincount(groups, (modes**2 + posterior)[among], most)
        before = np.bincount(groups, start, most) / np.maximum(known, 1)
        found = ((power + PSEUDO_COUNT * before) / (known + PSEUDO_COUNT))[groups]
        return np.asarray(np.where(start == self.start[0, 0], start, found))


def mode_groups(size: Sequence[int]) -> Array:
    """The group (h, w) of each mode, those of about one period; columns and rows have groups of their own."""
    band = np.floor(2 * np.log2(np.maximum(mode_radius(size), 1.0))).astype(int)  # half an octave each
    axis = np.zeros(band.shape, int)
    axis[1:, 0], axis[0, 1:] = 1, 2
    return 3 * band + axis


def shared_share(one: Array, other: Array) -> Array:
    """Share (h, w), between 0 and 1, of the variance of the mean of two estimates that is common to both.

    Args:
        one, other: modes of two patterns with independent errors, (h, w).
    """
    groups = mode_groups(one.shape).ravel()
    common = np.bincount(groups, (one * other).ravel())
    total = np.bincount(groups, ((one + other) ** 2 / 4).ravel())
    share = np.clip(common / np.maximum(total, np.finfo(float).tiny), 0, 1)
    return np.asarray(share[groups].reshape(one.shape))


def group_power(modes: Array) -> Array:
    """Mean square (h, w) of modes (h, w) over those of each group."""
    groups = mode_groups(modes.shape).ravel()
    mean = np.bincount(groups, modes.ravel() ** 2) / np.maximum(np.bincount(groups), 1)
    return np.asarray(mean[groups].reshape(modes.shape))
