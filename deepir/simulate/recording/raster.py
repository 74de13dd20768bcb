"""Kernels of the renderer: each fine sample looks up where its ray meets a surface."""

from __future__ import annotations

import numpy as np
from numba import njit

from deepir.kernels.compile import compiled

SAMPLES_PER_PIXEL = 2  # samples along a pixel's side
MAX_TEXTURE_PROBES = 5  # samples of a texture along the longer side of a sample's footprint
MIN_VISIBLE_SHARE = 1e-3  # share of a sample below which a surface is skipped
MAX_INVERSE_DEPTH = 20.0  # inverse of the least depth that is rendered, 1/m


@njit(inline="always")
def _mirrored(at: int, side: int) -> int:
    at %= 2 * side
    return 2 * side - 1 - at if at >= side else at


@njit
def _level(
    values: np.ndarray, cover: np.ndarray, levels: np.ndarray, level: int, x: float, y: float
) -> tuple[float, float]:
    """Linear between the texels of a level, mirrored at its edges; x and y in texels of level 0, which begins at 0."""
    height, width, start = levels[level, 0], levels[level, 1], levels[level, 2]
    shrink = 1.0 / (1 << level)
    x, y = x * shrink - 0.5, y * shrink - 0.5
    left, top = int(np.floor(x)), int(np.floor(y))
    u, v = x - left, y - top
    right, below = left + 1, top + 1
    if left < 0 or right >= width:
        left, right = _mirrored(left, width), _mirrored(right, width)
    if top < 0 or below >= height:
        top, below = _mirrored(top, height), _mirrored(below, height)
    top, below = start + top * width, start + below * width
    a, b, c, d = (1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u
    value = (
        a * values[top + left]
        + b * values[top + right]
        + c * values[below + left]
        + d * values[below + right]
    )
    if len(cover) == 0:
        return value, 1.0
    hides = (
        a * cover[top + left] + b * cover[top + right] + c * cover[below + left] + d * cover[below + right]
    )
    return value, hides


@njit
def _average(
    values: np.ndarray,
    cover: np.ndarray,
    levels: np.ndarray,
    at: tuple[float, float],
    u: tuple[float, float],
    v: tuple[float, float],
) -> tuple[float, float]:
    """Value and cover of a texture over the parallelogram u, v about a point (x, y), all in texels."""
    across, along = np.hypot(u[0], u[1]), np.hypot(v[0], v[1])
    longer = v
    if across > along:
        longer = u
        across, along = along, across
    size = max(across, along / MAX_TEXTURE_PROBES, 1.0)
    level = min(np.log2(size), len(levels) - 1.0)
    coarse = int(level)
    part = level - coarse
    count = min(max(int(np.ceil(along / size)), 1), MAX_TEXTURE_PROBES)
    value = hides = 0.0
    for k in range(count):
        way = (k + 0.5) / count - 0.5
        x, y = at[0] + way * longer[0], at[1] + way * longer[1]
        first, first_hides = _level(values, cover, levels, coarse, x, y)
        if part > 0:
            second, second_hides = _level(values, cover, levels, coarse + 1, x, y)
            first += part * (second - first)
            first_hides += part * (second_hides - first_hides)
        value += first
        hides += first_hides
    return value / count, hides / count


@compiled
def paint_surface(
    values: np.ndarray,
    cover: np.ndarray,
    levels: np.ndarray,
    texel: float,
    size: tuple[float, float],
    H: np.ndarray,
    first: tuple[float, float],
    step: float,
    box: tuple[int, int, int, int],
    moves: bool,
    near: np.ndarray,
    seen: np.ndarray,
    moving: np.ndarray,
    through: np.ndarray,
) -> None:
    """Paint a surface where it is nearer than the opaque surfaces so far.

    An opaque one (no `cover`) writes to `near`, the inverse of the depth. A cut-out is painted behind earlier cut-outs:
    `through` is the uncovered fraction of each sample.
    """
    for i in range(box[0], box[1]):
        v = first[1] + i * step
        for j in range(box[2], box[3]):
            u = first[0] + j * step
            w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
            if w <= near[i, j] or w > MAX_INVERSE_DEPTH or through[i, j] < MIN_VISIBLE_SHARE:
                continue
            s = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
            t = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
            if s < 0 or t < 0 or s > size[0] or t > size[1]:
                continue
            scale = step / (w * texel)
            along_u = ((H[0, 0] - s * H[2, 0]) * scale, (H[1, 0] - t * H[2, 0]) * scale)
            along_v = ((H[0, 1] - s * H[2, 1]) * scale, (H[1, 1] - t * H[2, 1]) * scale)
            value, hides = _average(values, cover, levels, (s / texel, t / texel), along_u, along_v)
            if len(cover) == 0:
                seen[i, j], near[i, j] = value, w
                moving[i, j] = 1.0 if moves else 0.0
            elif hides > MIN_VISIBLE_SHARE:
                seen[i, j] += through[i, j] * value
                moving[i, j] += through[i, j] * hides if moves else 0.0
                through[i, j] *= 1 - hides


@compiled
def paint_backdrop(
    values: np.ndarray,
    levels: np.ndarray,
    texel: float,
    start: tuple[float, float],
    R: np.ndarray,
    first: tuple[float, float],
    step: float,
    seen: np.ndarray,
    near: np.ndarray,
) -> None:
    """Paint the backdrop at infinity behind everything; it begins at azimuth and elevation `start`."""
    for i in range(seen.shape[0]):
        v = first[1] + i * step
        for j in range(seen.shape[1]):
            if near[i, j] > 0:
                continue
            u = first[0] + j * step
            x = R[0, 0] * u + R[0, 1] * v + R[0, 2]
            y = R[1, 0] * u + R[1, 1] * v + R[1, 2]
            z = R[2, 0] * u + R[2, 1] * v + R[2, 2]
            square = x * x + z * z
            level = np.sqrt(square)
            scale = step / texel
            au, av = (z * R[0, 0] - x * R[2, 0]) / square, (z * R[0, 1] - x * R[2, 1]) / square
            lu, lv = (x * R[0, 0] + z * R[2, 0]) / square, (x * R[0, 1] + z * R[2, 1]) / square
            tu, tv = (R[1, 0] - y * lu) / level, (R[1, 1] - y * lv) / level
            at = ((np.arctan2(x, z) - start[0]) / texel, (y / level - start[1]) / texel)
            along_u, along_v = (au * scale, tu * scale), (av * scale, tv * scale)
            seen[i, j], _ = _average(values, values[:0], levels, at, along_u, along_v)
