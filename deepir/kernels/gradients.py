# mypy: disable-error-code="no-untyped-def"
"""Gradients of pictures: total variation, fields of experts, and those that frames share."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled

FILTER_SIDE = 5  # side of a filter, px


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
