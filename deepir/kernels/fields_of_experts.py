# mypy: disable-error-code="no-untyped-def"
"""Fields of experts and their gradient."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled

#: Side of a filter, px.
FILTER_SIDE = 5


@compiled
def experts(first, last, value, share, filters, weights, tails, rounding, energy, gradient):
    """Rows [first, last) of a picture (h, w): `energy` (h), summed in float64, and its `gradient` (h, w).

    `filters` (C, FILTER_SIDE, FILTER_SIDE) are applied where they lie inside the picture. A response is weighted by the
    weight map `share` (h, w) at its centre and by `weights` (C); beyond `tails` (C) its cost grows as a square root.
    """
    height, width = value.shape
    half = FILTER_SIDE // 2
    e, one, inside = value.dtype.type(rounding), value.dtype.type(1), width - FILTER_SIDE + 1
    padded = np.zeros(width + FILTER_SIDE - 1, value.dtype)  # of answers, with nothing beyond both ends
    answer = padded[FILTER_SIDE - 1 : FILTER_SIDE - 1 + inside]
    for i in range(first, last):
        energy[i] = 0
        gradient[i] = 0
    # Middles whose filters reach these rows: those above and below are answered twice, by the next part too.
    for i in range(max(first - half, half), min(last + half, height - half)):
        counts = share[i, half:]
        for c in range(len(filters)):
            answer[:] = 0
            for a in range(FILTER_SIDE):
                f0, f1, f2, f3, f4 = filters[c, a]
                r = value[i + a - half]
                for j in range(inside):
                    answer[j] += f0 * r[j] + f1 * r[j + 1] + f2 * r[j + 2] + f3 * r[j + 3] + f4 * r[j + 4]
            total, w, tail = 0.0, weights[c], one / tails[c]
            for j in range(inside):
                squared = answer[j] * answer[j]
                length = np.sqrt(squared + e * e)
                long = squared / (length + e)
                root = np.sqrt(one + long * tail)
                counted = w * counts[j]
                total += counted * (long + long) / (one + root)
                answer[j] *= counted / (length * root)
            if first <= i < last:
                energy[i] += total
            for a in range(max(0, first - i + half), min(FILTER_SIDE, last - i + half)):
                f4, f3, f2, f1, f0 = filters[c, a]
                r, row = padded, gradient[i + a - half]
                for j in range(width):
                    row[j] += f0 * r[j] + f1 * r[j + 1] + f2 * r[j + 2] + f3 * r[j + 3] + f4 * r[j + 4]
