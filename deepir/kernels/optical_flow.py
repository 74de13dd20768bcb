# mypy: disable-error-code="no-untyped-def"
"""Loops of dense optical flow: bilinear sampling, box sums, and the iterations of Lucas and Kanade."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled


@compiled
def sample_bilinear(values, y, x, sampled):
    """Bilinear interpolation of `values` (h, w) at rows `y` and columns `x`; beyond the border, the nearest pixel.

    Args:
        values: (h, w), at least 2 x 2.
        y: rows, px, (m, n).
        x: columns, px, same shape.
        sampled: same shape, written.
    """
    height, width = values.shape
    for i in range(y.shape[0]):
        for j in range(y.shape[1]):
            row, column = min(max(y[i, j], 0.0), height - 1.0), min(max(x[i, j], 0.0), width - 1.0)
            top, left = min(int(row), height - 2), min(int(column), width - 2)
            down, right = row - top, column - left
            above = values[top, left] * (1 - right) + values[top, left + 1] * right
            below = values[top + 1, left] * (1 - right) + values[top + 1, left + 1] * right
            sampled[i, j] = above * (1 - down) + below * down


@compiled
def box_sum(values, radius, sums, rows):
    """Sums over windows of `2 radius + 1` px; the border's pixels are repeated beyond it.

    Args:
        values: (h, w).
        radius: half-width of the window, px.
        sums: (h, w), written.
        rows: (h, w), scratch.
    """
    height, width = values.shape
    for i in range(height):
        total = 0.0
        for j in range(-radius, radius + 1):
            total += values[i, min(max(j, 0), width - 1)]
        for j in range(width):
            rows[i, j] = total
            total += values[i, min(j + radius + 1, width - 1)] - values[i, max(j - radius, 0)]
    columns = np.zeros(width)
    # Arrays as a whole would take two seconds to compile.
    for i in range(-radius, radius + 1):
        row = rows[min(max(i, 0), height - 1)]
        for j in range(width):
            columns[j] += row[j]
    for i in range(height):
        entering, leaving = rows[min(i + radius + 1, height - 1)], rows[max(i - radius, 0)]
        for j in range(width):
            sums[i, j] = columns[j]
            columns[j] += entering[j] - leaving[j]


@compiled
def lucas_kanade(first, second, gradient, tensor, damping, radius, iterations, flow):
    """Flow that minimises in each window the squared difference of `first` and the displaced `second`.

    Args:
        first: (h, w).
        second: (h, w).
        gradient: of `first`, down and across, (2, h, w).
        tensor: structure tensor of `first` summed over windows, (yy, xy, xx), (3, h, w), of full rank.
        damping: what was added to the tensor's diagonal: in windows without texture the flow stays as it was.
        radius: half-width of a window, px.
        iterations: Gauss-Newton steps.
        flow: displacement down and across, px, (2, h, w): the start, and overwritten by the result.

    Source: Le Besnerais and Champagnat, "Dense optical flow by iterative local window registration", ICIP 2005.
    """
    height, width = first.shape
    y, x = np.empty((height, width)), np.empty((height, width))
    moved, rows = np.empty((height, width)), np.empty((height, width))
    down, across = np.empty((height, width)), np.empty((height, width))
    sum_down, sum_across = np.empty((height, width)), np.empty((height, width))
    for _ in range(iterations):
        for i in range(height):
            for j in range(width):
                y[i, j], x[i, j] = i + flow[0, i, j], j + flow[1, i, j]
        sample_bilinear(second, y, x, moved)
        for i in range(height):
            for j in range(width):
                gy, gx = gradient[0, i, j], gradient[1, i, j]
                change = first[i, j] - moved[i, j] + gy * flow[0, i, j] + gx * flow[1, i, j]
                down[i, j], across[i, j] = gy * change, gx * change
        box_sum(down, radius, sum_down, rows)
        box_sum(across, radius, sum_across, rows)
        for i in range(height):
            for j in range(width):
                yy, xy, xx = tensor[0, i, j], tensor[1, i, j], tensor[2, i, j]
                determinant = yy * xx - xy * xy
                along_y = sum_down[i, j] + damping * flow[0, i, j]
                along_x = sum_across[i, j] + damping * flow[1, i, j]
                flow[0, i, j] = (xx * along_y - xy * along_x) / determinant
                flow[1, i, j] = (yy * along_x - xy * along_y) / determinant
