"""Samples at an end of the range of the data."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

ADC_LIMITS = tuple(2.0**bits - 1 for bits in (8, 10, 12, 14, 15, 16))  # largest integers of common converters
CHANCE_COUNT = 20  # samples that may share an end of the range by chance
PILE_UP_RATIO = 4.0  # samples at an end of the range over those at a neighbouring value
NEIGHBOUR_VALUES = 5  # neighbouring values that are compared


def saturated_samples(frames: Array) -> Array | None:
    """Samples that are cut off at an end of the range.

    Integers cannot exceed the largest value of a converter. A cut-off end of the range holds many more samples than any
    neighbouring value. Pixels at the end in all frames are ignored: they may be dead.

    Args:
        frames: (N, h, w), NaN where unknown.

    Returns:
        (N, h, w), int8: 1 at the top, -1 at the bottom, else 0; None if nothing is cut off.
    """
    found = np.zeros(frames.shape, np.int8)
    for sign, end in ((1, np.nanmax(frames)), (-1, np.nanmin(frames))):
        there = frames == end
        passing = int((there & ~(there | np.isnan(frames)).all(0)).sum())
        limit = end in ADC_LIMITS and sign > 0 and np.array_equal(frames, np.rint(frames), equal_nan=True)
        if (passing and limit) or (passing >= CHANCE_COUNT and _piled_up(sign * frames, passing)):
            found[there] = sign
    return found if found.any() else None


def _piled_up(frames: Array, count: int) -> bool:
    """True if `count` is far above the number of samples at any value next to the largest."""
    _, counts = np.unique(frames[np.isfinite(frames)], return_counts=True)
    return len(counts) > 1 and count > PILE_UP_RATIO * counts[-NEIGHBOUR_VALUES - 1 : -1].max()
