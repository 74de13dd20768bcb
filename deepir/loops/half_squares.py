# mypy: disable-error-code="no-untyped-def"
"""The sum of squared, weighted residuals."""

from __future__ import annotations

from deepir.loops import compiled


@compiled
def half_squares(first, last, prediction, data, precision, weighted, nats):
    """Rows [first, last) of (rows, w): the `weighted` residuals, and their part of the sum, `nats` (rows)."""
    for i in range(first, last):
        p, y, w, into, total = prediction[i], data[i], precision[i], weighted[i], 0.0
        for j in range(len(p)):
            residual = p[j] - y[j]
            into[j] = w[j] * residual
            total += residual * into[j]
        nats[i] = total / 2


@compiled
def of_sensor(first, last, flux, data, precision, gain, offset, covariance, level, slope, nats, drift):
    """Rows [first, last) of frames (rows, w) that a sensor made of `flux`, with gain and offset (rows of a frame, w).

    The `slope` in the flux, (rows, w), the rows' parts of the sum, `nats`, and of its slope in the level, `drift`.
    To the slope comes what the `covariance` (2, h, w) makes of the flux.
    """
    height = len(gain)
    for i in range(first, last):
        z, y, w, g, o = flux[i], data[i], precision[i], gain[i % height], offset[i % height]
        of_gain, with_offset = covariance[0, i % height], covariance[1, i % height]
        into, less, total, along = slope[i], level[i // height], 0.0, 0.0
        for j in range(len(z)):
            residual = g[j] * z[j] + o[j] + less - y[j]
            weighted = w[j] * residual
            into[j] = g[j] * weighted + w[j] * (of_gain[j] * z[j] + with_offset[j])
            total += residual * weighted
            along += weighted
        nats[i], drift[i] = total / 2, along
