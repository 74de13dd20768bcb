# mypy: disable-error-code="no-untyped-def"
"""Total variation and its gradient."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled


@compiled
def total_variation(first, last, value, share, rounding, energy, gradient):
    """Rows [first, last) of a picture (h, w): `energy` (h), summed in float64, and its `gradient` (h, w).

    A place counts by its `share` (h, w).
    """
    height, width = value.shape
    e = value.dtype.type(rounding)
    beside, down = np.empty(width, value.dtype), np.empty(width, value.dtype)
    above, right = np.zeros(width, value.dtype), np.zeros(width + 1, value.dtype)
    for i in range(max(first - 1, 0), last):  # the row above is part of the first one's gradient
        here, below, counts = value[i], value[min(i + 1, height - 1)], share[i]
        for j in range(width):
            beside[j] = here[min(j + 1, width - 1)]
        total, to_right = 0.0, right[1:]
        for j in range(width):
            d, r = below[j] - here[j], beside[j] - here[j]
            squared = d * d + r * r
            length = np.sqrt(squared + e * e)
            # The same as the difference, without its cancellation.
            total += counts[j] * squared / (length + e)
            down[j], to_right[j] = counts[j] * d / length, counts[j] * r / length
        if i >= first:
            energy[i] = total
            into = gradient[i]
            for j in range(width):
                into[j] = above[j] - down[j] + right[j] - to_right[j]
        above, down = down, above
