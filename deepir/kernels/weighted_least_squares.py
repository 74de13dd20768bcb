# mypy: disable-error-code="no-untyped-def"
"""The sum of squared, weighted residuals."""

from __future__ import annotations

from deepir.kernels.compile import compiled


@compiled
def weighted_residuals(first, last, prediction, data, precision, weighted, nats):
    """Rows [first, last) of (rows, w): the `weighted` residuals, and their part of the sum, `nats` (rows)."""
    for i in range(first, last):
        p, y, w, into, total = prediction[i], data[i], precision[i], weighted[i], 0.0
        for j in range(len(p)):
            residual = p[j] - y[j]
            into[j] = w[j] * residual
            total += residual * into[j]
        nats[i] = total / 2


@compiled
def sensor_weighted_residuals(
    first, last, flux, data, precision, gain, offset, level, u, v, system, slope, nats, drift
):
    """Rows [first, last) of frames (N, h, w) that a sensor made of `flux`, with gain and offset (h, w).

    The `slope` in the flux, (N, h, w), the rows' parts of the sum, `nats` (N, h), and of its slope in the level,
    `drift`. To the slope comes what the covariance of a pixel's own gain and offset makes of the flux; u and v are
    their prior variances, `system` (aa, ab) that of all others.
    """
    for i in range(first, last):
        g, o = gain[i], offset[i]
        for k in range(len(flux)):
            z, y, w, into = flux[k, i], data[k, i], precision[k, i], slope[k, i]
            less, total, along = level[k], 0.0, 0.0
            if u > 0:
                aa, ab = system[0, i], system[1, i]
                for j in range(len(z)):
                    residual = g[j] * z[j] + o[j] + less - y[j]
                    weighted = w[j] * residual
                    into[j] = g[j] * weighted + w[j] * ((u - u * u * aa[j]) * z[j] - u * v * ab[j])
                    total += residual * weighted
                    along += weighted
            else:
                for j in range(len(z)):
                    residual = g[j] * z[j] + o[j] + less - y[j]
                    weighted = w[j] * residual
                    into[j] = g[j] * weighted
                    total += residual * weighted
                    along += weighted
            nats[k, i], drift[k, i] = total / 2, along
