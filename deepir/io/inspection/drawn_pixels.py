"""Pixels that hold one value in all frames while the others change: what a camera draws over its pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import convolve

from deepir.messages import Message

MAX_SHARE = 0.2  # of the pixels; more: the frames hardly change
MIN_NEIGHBOURS = 2  # of the eight around a pixel that are drawn too; fewer: a dead pixel
MIN_PIXELS = 20  # fewer are defective ones
COMMON_VALUES, MIN_COMMON_SHARE = 3, 0.6  # shades of what is drawn, and share of its pixels that have them

Array = np.ndarray[Any, np.dtype[Any]]


def drawn_pixels(frames: Array) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Such pixels (h, w) of frames (N, h, w), bool, side by side; none of frames that are all alike."""
    same = (frames == frames[:1]).all(0)
    if len(frames) < 2 or same.mean() > MAX_SHARE:
        return np.zeros_like(same)
    around = convolve(same.astype(np.int8), np.ones((3, 3), np.int8), mode="constant") - same
    drawn: np.ndarray[Any, np.dtype[np.bool_]] = same & (around >= MIN_NEIGHBOURS)
    shades = np.sort(np.unique(frames[0][drawn], return_counts=True)[1])
    is_drawn = drawn.sum() >= MIN_PIXELS and shades[-COMMON_VALUES:].sum() >= MIN_COMMON_SHARE * drawn.sum()
    return drawn if is_drawn else np.zeros_like(same)


def drawn_message(drawn: np.ndarray[Any, np.dtype[np.bool_]]) -> list[str]:
    """A warning on such pixels (h, w); [] if there are none."""
    if not drawn.any():
        return []
    y, x = drawn.nonzero()
    return [
        Message(
            "drawn-pixels",
            f"{len(y)} pixel(s) between rows {y.min()} and {y.max()}, columns {x.min()} and {x.max()} hold one value "
            "in all frames: text or marks that are drawn over the picture, or cut off at an end of the range. "
            "data.mask, or data.crop, leaves them out",
        )
    ]
