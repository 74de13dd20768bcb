"""Samples of frames."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def as_float32(frame: Array) -> Array:
    """Samples (..., h, w) as a float32 copy; masked ones are NaN."""
    samples: Array = np.ma.filled(frame.astype(np.float32), np.nan)
    return samples
