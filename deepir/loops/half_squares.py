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
