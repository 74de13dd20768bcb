"""Maps packed for a page: 16-bit levels, which `web/maps.js` unpacks."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from deepir.io.output.tone_mapping import display_limits

Array = np.ndarray[Any, Any]
MISSING_LEVEL = 65535  # level of samples that are not finite
FINE_LEVELS = 4096  # levels between the display limits
COARSE_LEVELS = 256  # the same, at least, of maps with far outliers


def pack_map(image: Array, fine: int = FINE_LEVELS) -> dict[str, Any]:
    """Levels of a map (h, w) as text, with the data to read them: `value = base + step * level`.

    Levels are differences along x, high bytes first, for compression.

    Args:
        image: (h, w).
        fine: Levels between the display limits.
    """
    whole, image = image.dtype == bool, np.asarray(image, np.float64)
    finite = image[np.isfinite(image)]
    least, most = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    low, high = display_limits(image)
    span = high - low or most - least or 1.0
    step = 1.0 if whole else np.clip((most - least) / (MISSING_LEVEL - 1), span / fine, span / COARSE_LEVELS)
    base = max(least, low - step * MISSING_LEVEL / 2)
    levels = np.round((np.where(np.isfinite(image), image, base) - base) / step).clip(0, MISSING_LEVEL - 1)
    levels = np.where(np.isfinite(image), levels, MISSING_LEVEL).astype("<u2", order="C")
    levels[:, 1:] -= levels[:, :-1].copy()
    planes = levels.view(np.uint8).reshape(-1, 2).T[::-1].tobytes()
    return {
        "height": image.shape[0],
        "width": image.shape[1],
        "base": float(base),
        "step": float(step),
        "low": low,
        "high": high if high > low else low + span,
        "levels": base64.b64encode(zlib.compress(planes, 1)).decode(),
    }
