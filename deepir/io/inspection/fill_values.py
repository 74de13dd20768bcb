"""Values that stand for lost samples, as mapping software writes them."""

from __future__ import annotations

from typing import Any

import numpy as np

#: Of GDAL, Pix4D, ENVI, NetCDF and others, for floats and signed integers.
FILL_VALUES = (
    *(-9999.0, 9999.0, -99999.0, 99999.0, -999.0, -10000.0, -32768.0, -32767.0, -2147483648.0),
    *(-3.4028234663852886e38, 3.4028234663852886e38, 1e20, -1e20, 9.969209968386869e36, -1e30, 1e30, -1e31),
)
UNSIGNED_FILL = 65535.0  # of 16-bit counts
MIN_ZERO_GAP = 0.25  # of the range of the others, between which and a zero among floats no sample lies
SAMPLES = 100_000  # that the range of the others is measured of

Frames = np.ndarray[Any, np.dtype[np.float32]]


def lost_samples(frames: Frames, stored: np.dtype[Any]) -> np.ndarray[Any, np.dtype[np.bool_]] | None:
    """Samples that hold a fill value, further away from all others than their range.

    Args:
        frames: (N, h, w), float32.
        stored: Type that they were stored in: unsigned counts have no fill value but the largest of 16 bits.

    Returns:
        (N, h, w) bool; None if there are none.
    """
    if stored.kind == "u" and stored.itemsize != 2:
        return None
    values = (UNSIGNED_FILL,) if stored.kind == "u" else FILL_VALUES
    if stored.kind == "f":
        values = (*values, 0.0)
    found = None
    least, largest = np.fmin.reduce(frames, axis=None), np.fmax.reduce(frames, axis=None)
    for value in (each for each in values if least <= np.float32(each) <= largest):
        if not (lost := frames == np.float32(value)).any() or lost.all():
            continue
        others = frames[~lost]
        others = others[:: max(1, len(others) // SAMPLES)]
        others = others[np.isfinite(others) & ~np.isin(others, np.array(values, np.float32))]
        if not len(others):
            continue
        low, high = float(others.min()), float(others.max())
        gap = MIN_ZERO_GAP if value == 0 else 1.0
        if max(low - value, value - high) > gap * (high - low):
            found = lost if found is None else found | lost
    return found
