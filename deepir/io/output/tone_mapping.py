"""Tone mapping: values to grey levels and colours, for display only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from deepir.io.output.palettes import WHITE_HOT, colour_table

Array = np.ndarray[Any, Any]
PERCENTILE = "percentile"  # the default tone mapping


def apply_palette(shades: Array, palette: str) -> Array:
    """Grey levels (..., h, w) from 0 to 1 as uint8: (..., h, w) for `white-hot`, else (..., h, w, 3)."""
    levels = np.round(255 * shades).astype(np.uint8)
    return levels if palette == WHITE_HOT else colour_table(palette)[levels]


def percentile(image: Array) -> Array:
    """Linear tone mapping of an image (h, w) between its percentiles 0.5 and 99.5; 0 where it is not finite."""
    return stretch(image, *display_limits(image))


def clahe(image: Array) -> Array:
    """Contrast-limited adaptive histogram equalisation of an image (h, w), for scenes with hot and cold parts.

    Source: Pizer et al., Adaptive histogram equalization and its variations (1987), as in scikit-image.
    """
    from skimage.exposure import equalize_adapthist

    shades = percentile(image)
    return shades if shades.min() == shades.max() else equalize_adapthist(shades, clip_limit=0.02)


def display_limits(image: Array) -> tuple[float, float]:
    """Percentiles 0.5 and 99.5 of the finite values; zeros if there is none."""
    finite = image[np.isfinite(image)]
    low, high = np.percentile(finite, [0.5, 99.5]) if finite.size else (0.0, 0.0)
    return float(low), float(high)


def stretch(image: Array, low: float, high: float) -> Array:
    """Linear map of [low, high] to [0, 1], clipped; 0 where the image is not finite."""
    scale = 1 / (high - low) if high > low else 0.0
    return np.clip((np.where(np.isfinite(image), image, low) - low) * scale, 0, 1)


#: Tone mappings by name.
TONE_MAPPINGS: dict[str, Callable[[Array], Array]] = {PERCENTILE: percentile, "clahe": clahe}
