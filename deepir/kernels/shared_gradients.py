# mypy: disable-error-code="no-untyped-def"
"""The gradient that frames of different scenes share at each edge, robustly."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled


@compiled
def shared_gradients(first, last, frames, usable, variances, down, right, iterations, gradients, weights):
    """The likeliest common gradient at each edge, if the scenes' gradients are Cauchy distributed.

    Args:
        first, last: rows of edges to compute.
        frames: (N, h, w), float32.
        usable: (N, h, w), uint8, which samples count.
        variances: squared scale of the gradients of each frame, (N,).
        down, right: the other pixel of an edge, px: (1, 0) or (0, 1).
        iterations: of reweighting, from the median.
        gradients: (h - down, w - right), written.
        weights: same shape, written: the sum of the weights, 0 where no frame counts.
    """
    count, _, width = frames.shape
    steps, scales = np.empty(count, np.float32), np.empty(count, np.float32)
    for i in range(first, last):
        for j in range(width - right):
            known = 0
            for k in range(count):
                if usable[k, i, j] and usable[k, i + down, j + right]:
                    steps[known] = frames[k, i + down, j + right] - frames[k, i, j]
                    scales[known] = variances[k]
                    known += 1
            common, total = 0.0, 0.0
            if known:
                common = np.median(steps[:known])
            for _ in range(iterations):
                total, moment = 0.0, 0.0
                for k in range(known):
                    rest = steps[k] - common
                    weight = 1 / (scales[k] + rest * rest)
                    total += weight
                    moment += weight * steps[k]
                if total > 0:
                    common = moment / total
            gradients[i, j], weights[i, j] = common, total
