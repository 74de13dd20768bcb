"""Detect frames whose contrast was stretched individually (automatic gain control, normalisation)."""

from __future__ import annotations

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
MAX_CLIPPED_SHARE = 0.5  # share of a frame at the ends of the range from which its samples are kept


def is_contrast_stretched(frames: Array) -> bool:
    """True if frames may have individual contrasts: 8 bits, or all of one range.

    An automatic gain control gives such frames, and so does normalisation of each frame to [0, 1]. Pixels at an end of
    the range in all frames are dead and are ignored.

    Args:
        frames: (N, h, w), NaN where unknown.
    """
    if has_eight_bits(frames):
        return True
    ends = [frames == end for end in (np.nanmin(frames), np.nanmax(frames))]
    return all((end & ~end.all(0)).any((1, 2)).all() for end in ends)


def has_eight_bits(frames: Array) -> bool:
    """True if frames (N, h, w), NaN where unknown, hold nothing but integers from 0 to 255."""
    low, high = np.nanmin(frames), np.nanmax(frames)
    return bool(low >= 0 and 1 < high <= 255) and np.array_equal(frames, np.rint(frames), equal_nan=True)


def clipped_samples(frames: Array) -> Array:
    """Samples of frames (N, h, w), bool, at an end of the range; none of frames that mostly are."""
    cut = (frames == np.nanmin(frames)) | (frames == np.nanmax(frames))
    return np.asarray(cut & (cut.mean((1, 2), keepdims=True) < MAX_CLIPPED_SHARE))
