"""Autocorrelation of maps."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import fft

Array = np.ndarray[Any, Any]
MAX_LAG = 50  # px


def autocorrelation(pattern: Array, twin: Array, good: Array) -> Array:
    """Of maps (h, w), zero where not good, at lags up to a quarter of the shorter side and at most 50 px."""
    farthest = min(MAX_LAG, min(pattern.shape) // 4)
    size = [fft.next_fast_len(side + farthest) for side in pattern.shape]
    one, other, seen = (fft.rfft2(each, size) for each in (pattern, twin, good.astype(float)))
    products, pairs = (fft.irfft2(a.conj() * b, size) for a, b in ((one, other), (seen, seen)))
    lags = np.arange(-farthest, farthest + 1)
    found = (products / pairs.clip(min=1))[np.ix_(lags, lags)]
    found = (found + found[::-1, ::-1]) / 2
    return np.asarray(found / max(found[farthest, farthest], 1e-300))
