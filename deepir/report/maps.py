"""Maps packed for a page: levels of 16 bits, which `web/maps.js` unpacks and reads values from."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np

from deepir.io.output.tone_mapping import ends

Array = np.ndarray[Any, Any]
MISSING = 65535  # the level of what is not finite
FINE, COARSE = 4096, 256  # levels between the percentiles that are shown: so many, or fewer for far outliers


def packed(image: Array, fine: int = FINE) -> dict[str, Any]:
    """Levels of a map (h, w) as text, and what a page needs to show and read them: `value = base + step * level`.

    Levels are differences along x, high bytes first and then low ones: so they shrink best.
    """
    whole, image = image.dtype == bool, np.asarray(image, np.float64)
    finite = image[np.isfinite(image)]
    least, most = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    low, high = ends(image)
    span = high - low or most - least or 1.0
    step = 1.0 if whole else np.clip((most - least) / (MISSING - 1), span / fine, span / COARSE)
    base = max(least, low - step * MISSING / 2)
    levels = np.round((np.where(np.isfinite(image), image, base) - base) / step).clip(0, MISSING - 1)
    levels = np.where(np.isfinite(image), levels, MISSING).astype("<u2", order="C")
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
