# mypy: disable-error-code="no-untyped-def"
"""Passes of registration: frames pulled back, their differences from the scene, and the sums of a Gauss-Newton step.

All arrays are float32; motions (N, 3, 3) go from indices (x, y, 1) to indices. Samples are bilinear: right for a ramp,
as cubic convolution is not, and enough for what is band-passed.
"""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled

MIN_DEPTH = np.float32(1e-3)  # smallest depth of a projected point; float32, as the operands are
EDGE_TOLERANCE = np.float32(1e-3)  # how far a point may lie beyond the outermost pixel, by rounding, px
#: Numbers in float32: with integers of Python numba computes in float64.
ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)


@compiled
def _sample(image, weight, whole, t, i, at, f, g, values, known):
    """Row `i`: `image` (h, w) at moved points, and whether it is known there; zero where it is not."""
    height, width = image.shape
    flat, weights = image.ravel(), weight.ravel()
    to_x, to_y, y = np.float32(width - 1), np.float32(height - 1), np.float32(i)
    ax, ay, az = t[0, 0], t[1, 0], t[2, 0]
    bx, by, bz = t[0, 1] * y + t[0, 2], t[1, 1] * y + t[1, 2], t[2, 1] * y + t[2, 2]
    for j in range(width):
        x = np.float32(j)
        nearness = ONE / max(az * x + bz, MIN_DEPTH)
        px, py = (ax * x + bx) * nearness, (ay * x + by) * nearness
        beyond = max(-px, px - to_x, -py, py - to_y)
        known[j] = ONE if beyond < EDGE_TOLERANCE else ZERO
        # In this order a NaN, too, ends up inside.
        px, py = px if px > ZERO else ZERO, py if py > ZERO else ZERO
        px, py = px if px < to_x else to_x, py if py < to_y else to_y
        left, top = np.int32(min(px, to_x - ONE)), np.int32(min(py, to_y - ONE))
        f[j], g[j] = px - np.float32(left), py - np.float32(top)
        at[j] = top * np.int32(width) + left
    if not whole:
        for j in range(width):
            known[j] *= weights[at[j] + (width if g[j] > HALF else 0) + (1 if f[j] > HALF else 0)]
    j = 0
    while j < width:  # run by run of samples whose neighbours lie side by side: no gather
        start, end = at[j] - j, j + 1
        while end < width and at[end] - end == start:
            end += 1
        above, below = flat[at[j] :], flat[at[j] + width :]
        of_x, of_y, there, into = f[j:end], g[j:end], known[j:end], values[j:end]
        for m in range(end - j):
            upper = above[m] + of_x[m] * (above[m + 1] - above[m])
            lower = below[m] + of_x[m] * (below[m + 1] - below[m])
            into[m] = there[m] * (upper + of_y[m] * (lower - upper))
        j = end


@compiled
def sample_images(first, last, images, weight, whole, motion, values, known):
    """Rows [first, last) of `images` (1 or N, h, w) at moved points: `values`, and where they are `known`."""
    width = values.shape[2]
    at, f, g = np.empty(width, np.int32), np.empty(width, np.float32), np.empty(width, np.float32)
    for k in range(len(motion)):
        for i in range(first, last):
            image = images[k % len(images)]
            _sample(image, weight, whole, motion[k], i, at, f, g, values[k, i], known[k, i])


@compiled
def residual_moments(first, last, frames, weight, whole, picture, motion, count, mean, rest, power):
    """Rows [first, last) of what `frames` (N, h, w) are beside a `picture` (h, w) at moved points.

    For each pixel over the frames: samples that are known, their mean, and the sum of squares about it; and the frames'
    `power` (h) there.
    """
    width = frames.shape[2]
    at, f, g = np.empty(width, np.int32), np.empty(width, np.float32), np.empty(width, np.float32)
    values, known = np.empty(width, np.float32), np.empty(width, np.float32)
    for i in range(first, last):
        n, total, square, energy = count[i], mean[i], rest[i], 0.0
        n[:], total[:], square[:] = 0, 0, 0
        for k in range(len(frames)):
            _sample(picture, weight, whole, motion[k], i, at, f, g, values, known)
            seen = frames[k, i]
            for j in range(width):
                here = known[j] * seen[j]
                apart = here - values[j]
                n[j] += known[j]
                total[j] += apart
                square[j] += apart * apart
                energy += here * here
        power[i] = energy
        for j in range(width):
            total[j] /= max(n[j], ONE)
            square[j] -= n[j] * total[j] * total[j]


@compiled
def _expect(seen, known, total, count, expected, both):
    """A row of the mean of the other frames, and whether it and the frame are known."""
    for j in range(len(seen)):
        n = count[j] - known[j]
        expected[j] = (total[j] - seen[j]) / max(n, ONE)
        both[j] = known[j] if n > HALF else ZERO


@compiled
def gauss_newton_sums(first, last, frames, known, total, count, ax, ay, stride, unit, middle, limit, sums):
    """Sums (rows, N, P + 2, P + 3) over every `stride`-th pixel of rows [first, last) but the outermost.

    Of products of all that a frame (h, w) may differ by from the mean of the others: what the motion's parameters
    change, `ax` and `ay` (P, rows, columns) a px of slope; gain; level; and, last, what it does differ by. Under
    Tukey's weights about `middle` (N), zero from `limit` (N) on. `unit` is the size of a pixel.
    """
    width, columns, parameters = frames.shape[2], ax.shape[2], len(ax)
    above, here, below = np.empty((3, width), np.float32)
    over, both, under = np.empty((3, width), np.float32)
    each, weight = np.empty((parameters + 3, columns), np.float32), np.empty(columns, np.float32)
    half = HALF / np.float32(unit)
    for row in range(first, last):
        i = 1 + row * stride
        for k in range(len(frames)):
            seen, there = frames[k], known[k]
            _expect(seen[i - 1], there[i - 1], total[i - 1], count[i - 1], above, over)
            _expect(seen[i], there[i], total[i], count[i], here, both)
            _expect(seen[i + 1], there[i + 1], total[i + 1], count[i + 1], below, under)
            for m in range(columns):
                j = 1 + m * stride
                slope_x, slope_y = half * (here[j + 1] - here[j - 1]), half * (below[j] - above[j])
                for p in range(parameters):
                    each[p, m] = slope_x * ax[p, row, m] + slope_y * ay[p, row, m]
                apart = seen[i, j] - here[j]
                far = (apart - middle[k]) / limit[k]
                inside = max(ONE - far * far, ZERO)
                weight[m] = both[j - 1] * both[j] * both[j + 1] * over[j] * under[j] * inside * inside
                each[parameters, m], each[parameters + 1, m], each[parameters + 2, m] = here[j], ONE, apart
            for p in range(parameters + 2):
                for q in range(p, parameters + 3):
                    product, one, other = ZERO, each[p], each[q]
                    for m in range(columns):
                        product += weight[m] * one[m] * other[m]
                    sums[row, k, p, q] = product
                    if q < parameters + 2:
                        sums[row, k, q, p] = product
