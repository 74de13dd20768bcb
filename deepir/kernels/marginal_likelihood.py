# mypy: disable-error-code="no-untyped-def"
"""Likelihood of the strengths of gain and offset; see `deepir.estimation.variance_components`."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled
from deepir.kernels.dispatch import DETERMINANTS_PER_LOG


@compiled
def negative_log_likelihood(first, last, values, counts, u, v, sums):
    """Sums over those of the values (aa, ab, bb, s, t), (5, K), that count (K,), for variances u and v: `sums` (6,).

    Of `log det(1 + A V) - s' V (1 + A V)^-1 s`, of its slope in u and v, and of its curvature (uu, uv, vv).
    """
    nats, by_u, by_v, by_uu, by_uv, by_vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for start in range(0, values.shape[1], DETERMINANTS_PER_LOG):
        product = 1.0
        for k in range(start, min(start + DETERMINANTS_PER_LOG, values.shape[1])):
            aa, ab, bb, s, t = values[0, k], values[1, k], values[2, k], values[3, k], values[4, k]
            one, whole = 1.0 if counts[k] else 0.0, aa * bb - ab * ab
            system = 1 + u * aa + v * bb + u * v * whole
            # (1 + A V)^-1 times A, and times s.
            scale = one / system
            p, q, r = (aa + v * whole) * scale, ab * scale, (bb + u * whole) * scale
            x, y = (s + v * (bb * s - ab * t)) * scale, (t + u * (aa * t - ab * s)) * scale
            product *= system if counts[k] else 1.0
            nats -= u * s * x + v * t * y
            by_u, by_v = by_u + p - x * x, by_v + r - y * y
            by_uu += p * (2 * x * x - p)
            by_uv += q * (2 * x * y - q)
            by_vv += r * (2 * y * y - r)
        nats += np.log(product)
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = nats, by_u, by_v, by_uu, by_uv, by_vv
