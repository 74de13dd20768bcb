# mypy: disable-error-code="no-untyped-def"
"""Bilinear samples of images at moved pixels."""

from __future__ import annotations

import numpy as np

from deepir.loops import compiled

NEAR = 1e-3  # least depth


@compiled
def sample(first, last, images, motion, weight, whole, values, known):
    """Rows [first, last) of `values` (N, h, w): `images` (1 or N, h, w) at the indices that `motion` (N, 3, 3) gives.

    `known` is one inside the image where, unless it is known as a `whole`, the nearest pixel has `weight` (h, w).
    Values are zero elsewhere.
    """
    height, width = weight.shape
    x, y = np.empty(width), np.empty(width)
    for k in range(len(motion)):
        t, flat = motion[k], images[k % len(images)].ravel()
        beside, lower, lower_beside = flat[1:], flat[width:], flat[width + 1 :]
        for i in range(first, last):
            into, there = values[k, i], known[k, i]
            for j in range(width):
                depth = t[2, 0] * j + (t[2, 1] * i + t[2, 2])
                nearness = 1 / (depth if depth > NEAR else NEAR)
                x[j] = (t[0, 0] * j + (t[0, 1] * i + t[0, 2])) * nearness
                y[j] = (t[1, 0] * j + (t[1, 1] * i + t[1, 2])) * nearness
            for j in range(width):
                inside = x[j] >= 0 and y[j] >= 0 and x[j] <= width - 1 and y[j] <= height - 1
                px, py = (x[j], y[j]) if inside else (0.0, 0.0)
                left, top = min(np.int32(px), np.int32(width - 2)), min(np.int32(py), np.int32(height - 2))
                fx, fy = np.float32(px - left), np.float32(py - top)
                at = np.uint32(top * np.int32(width) + left)  # not signed: no check for negative ones
                above = flat[at] + fx * (beside[at] - flat[at])
                below = lower[at] + fx * (lower_beside[at] - lower[at])
                there[j] = np.float32(inside)
                into[j] = there[j] * (above + fy * (below - above))
            if not whole:
                for j in range(width):
                    if there[j] > 0:
                        there[j] = weight[np.int64(y[j] + 0.5), np.int64(x[j] + 0.5)]
                        into[j] *= there[j]
