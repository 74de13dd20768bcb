"""Fourier ring correlation of two pictures of the same thing: down to which detail they agree.

Sources: Saxton & Baumeister, J. Microscopy 127 (1982); the threshold of 1/7: Rosenthal & Henderson, J. Mol. Biol. 333
(2003).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

Array = np.ndarray[Any, Any]

THRESHOLD = 1 / 7  # correlation at which detail of two halves is resolved
NYQUIST = 0.5  # cycles a px
MEDIAN_RINGS = 3  # over which a curve is smoothed before its crossing is sought


@dataclass(frozen=True)
class RingCorrelation:
    """Correlation of the spectra of two pictures over rings of frequency.

    Attributes:
        frequency: (R,), cycles a px, middle of each ring.
        correlation: (R,), between -1 and 1.
    """

    frequency: Array
    correlation: Array

    @property
    def resolution(self) -> float:
        """Period of the finest detail in which both agree, px: 2 at best, infinite if in none."""
        smooth = ndimage.median_filter(self.correlation, MEDIAN_RINGS, mode="nearest")
        below = np.flatnonzero(smooth < THRESHOLD)
        if not below.size:
            return 1 / NYQUIST
        k = int(below[0])
        return float(1 / self.frequency[k - 1]) if k else np.inf


def fourier_ring_correlation(first: Array, second: Array) -> RingCorrelation:
    """Correlate two pictures (h, w), finite, of the same thing with independent errors."""
    height, width = first.shape
    window = np.hanning(height + 2)[1:-1, None] * np.hanning(width + 2)[1:-1]
    one, other = (np.fft.rfft2((each - each.mean()) * window) for each in (first, second))
    radius = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width))
    rings = int(NYQUIST * min(height, width))
    ring = np.floor(radius / NYQUIST * rings).astype(int)
    inside = (ring < rings) & (radius > 0)

    def sums(values: Array) -> Array:
        return np.bincount(ring[inside], values[inside], rings)

    powers = sums(np.abs(one) ** 2) * sums(np.abs(other) ** 2)
    correlation = sums((one * other.conj()).real) / np.sqrt(np.maximum(powers, np.finfo(float).tiny))
    frequency = (np.arange(rings) + 0.5) * NYQUIST / rings
    return RingCorrelation(frequency, correlation)
