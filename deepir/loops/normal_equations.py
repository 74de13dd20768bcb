# mypy: disable-error-code="no-untyped-def"
"""The sums over the frames that gain and offset are found from."""

from __future__ import annotations

import numpy as np

from deepir.loops import compiled


@compiled
def normal_equations(first, last, flux, data, precision, sums):
    """`deepir.elimination.normal_equations` at pixels [first, last): arguments (N, pixels), `sums` (6, pixels)."""
    block = np.empty((5, 2048))  # stays in the cache
    aa, ab, bb, sa, sb = block[0], block[1], block[2], block[3], block[4]
    for start in range(first, last, 2048):
        stop = min(start + 2048, last)
        block[:] = 0
        m = flux[0, start:stop]
        for k in range(len(flux)):
            z, y, w = flux[k, start:stop], data[k, start:stop], precision[k, start:stop]
            for j in range(stop - start):
                d, weight = np.float64(z[j]) - m[j], np.float64(w[j])
                wd = weight * d
                aa[j] += wd * d
                ab[j] += wd
                bb[j] += weight
                sa[j] += wd * y[j]
                sb[j] += weight * y[j]
        for j in range(stop - start):
            i = start + j
            shifted = ab[j] + m[j] * bb[j]
            sums[0, i] = aa[j] + m[j] * (ab[j] + shifted)
            sums[1, i] = shifted
            sums[2, i] = bb[j]
            sums[3, i] = aa[j] * bb[j] - ab[j] * ab[j]
            sums[4, i] = sa[j] + m[j] * sb[j]
            sums[5, i] = sb[j]
