# mypy: disable-error-code="no-untyped-def"
"""A cubic B-spline at moved points, its adjoint, and its gradient in what moves them.

A motion is a homography (3, 3), or the points (2, h, w) themselves, x and y: the compiler sees which from the number of
dimensions. Origins are centres: of the frame, and of the canvas, whose sides are at least 4. For homographies no grid
of coordinates is ever written. (All in one file: numba's cache does not see a change in another one.)
"""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled
from deepir.kernels.threads import MIN_DEPTH

#: Not Python's integers, which with float32 make float64.
ONE, TWO, THREE, FOUR = np.float32(1), np.float32(2), np.float32(3), np.float32(4)


@compiled
def _project(t, x, y):
    """The point of homography `t`, its depth, and one over it."""
    depth = t[2, 0] * x + (t[2, 1] * y + t[2, 2])
    nearness = 1 / max(depth, MIN_DEPTH)
    px = (t[0, 0] * x + (t[0, 1] * y + t[0, 2])) * nearness
    py = (t[1, 0] * x + (t[1, 1] * y + t[1, 2])) * nearness
    return px, py, depth, nearness


@compiled
def _locate(t, y, height, width, at, ends, fx, fy):
    """Where the samples of a row look: index of the first of 16 coefficients, and how far beyond the sixth.

    From one sample of `ends` to the next the coefficients lie side by side: such a run needs no gather. `at` is set at
    its start.
    """
    count = len(fx)
    if t.ndim == 3:
        xs, vs = _row(t, y)
        to_x, to_y = fx.dtype.type((width - 1) / 2), fx.dtype.type((height - 1) / 2)
        for j in range(count):
            _place(j, xs[j] + to_x, vs[j] + to_y, height, width, at, fx, fy)
        _find_runs(at, ends)
        return
    x, v, _, nearness = _project(t, -(count - 1) / 2, y)
    x, v = x + (width - 1) / 2, v + (height - 1) / 2
    dx, dv = t[0, 0] * nearness, t[1, 0] * nearness
    last_x, last_v = x + dx * (count - 1), v + dv * (count - 1)
    inside = min(x, last_x) > 1 and max(x, last_x) < width - 2 and min(v, last_v) > 1 and max(v, last_v) < height - 2
    if t[2, 0] == 0 and inside:
        _locate_on_line(x, v, dx, dv, width, at, ends, fx, fy)
        return
    for j in range(count):
        x, v, _, _ = _project(t, j - (count - 1) / 2, y)
        _place(j, x + (width - 1) / 2, v + (height - 1) / 2, height, width, at, fx, fy)
    _find_runs(at, ends)


@compiled
def _row(points, y):
    """Both coordinates of a row of points, at `y` from the frame's centre."""
    i = int(y + (points.shape[1] - 1) / 2)
    return points[0, i], points[1, i]


@compiled
def _place(j, x, v, height, width, at, fx, fy):
    """Where sample `j` looks, at (x, v) from the canvas' corner."""
    # In this order a NaN, too, ends up inside.
    x = x if x > 1 else 1.0
    v = v if v > 1 else 1.0
    x = x if x < width - 2 else width - 2.0
    v = v if v < height - 2 else height - 2.0
    left, top = min(np.int32(x), np.int32(width - 3)), min(np.int32(v), np.int32(height - 3))
    at[j] = (top - np.int32(1)) * np.int32(width) + left - np.int32(1)
    fx[j], fy[j] = x - left, v - top


@compiled
def _find_runs(at, ends):
    """Where each run of samples ends whose coefficients lie side by side."""
    j, count = 0, len(at)
    while j < count:
        start, end = at[j] - j, j + 1
        while end < count and at[end] - end == start:
            end += 1
        ends[j], j = end, end


@compiled
def _reach(t, y, count, height):
    """Between which rows of the canvas, at least, lies what a row of a frame looks at."""
    low, high = height - 2.0, 1.0
    if t.ndim == 3:
        for at in _row(t, y)[1]:
            v = at + (height - 1) / 2
            v = v if v > 1 else 1.0
            v = v if v < height - 2 else height - 2.0
            low, high = min(low, v), max(high, v)
        return low, high
    _, y0, z0, _ = _project(t, -(count - 1) / 2, y)
    _, y1, z1, _ = _project(t, (count - 1) / 2, y)
    if not min(z0, z1) > MIN_DEPTH:
        return high, low
    middle = (height - 1) / 2
    return min(max(min(y0, y1) + middle, 1.0), low), max(min(max(y0, y1) + middle, low), 1.0)


@compiled
def _locate_on_line(x, v, dx, dv, width, at, ends, fx, fy):
    """The same where the points lie on a line, from (x, v) on, inside the canvas: run by run."""
    j, count, drift = 0, len(fx), dx - 1
    while j < count:
        here, down = x + dx * j, v + dv * j
        left, top = np.int64(here), np.int64(down)
        f, g = here - left, down - top
        # By rounding perhaps one too many: the weights go on smoothly.
        end = j + 1 + int(_within(f, drift, _within(g, dv, count - j - 1)))
        at[j], ends[j] = (top - 1) * width + left - 1, end
        step, fall = fx.dtype.type(drift), fx.dtype.type(dv)
        start, upper, of_x, of_y = fx.dtype.type(f), fx.dtype.type(g), fx[j:end], fy[j:end]
        for m in range(end - j):
            at_m = fx.dtype.type(m)
            of_x[m] = start + step * at_m
            of_y[m] = upper + fall * at_m
        j = end


@compiled
def _within(f, step, most):
    """How many steps, at most so many, a fraction stays one."""
    return min((1 - f if step > 0 else f) / abs(step), most) if step != 0 else float(most)


@compiled
def _weights(t):
    """Six times the spline's weights of the four coefficients around a point that is `t` beyond the second."""
    s = ONE - t
    return s * s * s, FOUR - THREE * t * t * (TWO - t), FOUR - THREE * s * s * (TWO - s), t * t * t


@compiled
def _slopes(t):
    """Twice the derivatives of the weights by `t`."""
    s = ONE - t
    return -s * s, t * (THREE * t - FOUR), s * (FOUR - THREE * s), t * t


@compiled
def _sum(x, y, first, second, third, fourth, m):
    """`Σ x y c` over 16 coefficients `c`, four of each row from `m` on."""
    a = x[0] * first[m] + x[1] * first[m + 1] + x[2] * first[m + 2] + x[3] * first[m + 3]
    b = x[0] * second[m] + x[1] * second[m + 1] + x[2] * second[m + 2] + x[3] * second[m + 3]
    c = x[0] * third[m] + x[1] * third[m + 1] + x[2] * third[m + 2] + x[3] * third[m + 3]
    d = x[0] * fourth[m] + x[1] * fourth[m + 1] + x[2] * fourth[m + 2] + x[3] * fourth[m + 3]
    return y[0] * a + y[1] * b + y[2] * c + y[3] * d


@compiled
def _combine(flat, width, at, ends, fx, fy, out):
    """The spline of the coefficients `flat` at each sample."""
    j, share = 0, out.dtype.type(1 / 36)
    while j < len(at):
        end = ends[j]
        first = flat[at[j] :]
        second, third, fourth = first[width:], first[2 * width :], first[3 * width :]
        beside, below, into = fx[j:end], fy[j:end], out[j:end]
        for m in range(end - j):
            x, y = _weights(beside[m]), _weights(below[m])
            into[m] = share * _sum(x, y, first, second, third, fourth, m)
        j = end


@compiled
def _combine_slopes(flat, width, at, ends, fx, fy, out_x, out_y):
    """Its derivatives along x and y."""
    j, share = 0, out_x.dtype.type(1 / 12)
    while j < len(at):
        end = ends[j]
        first = flat[at[j] :]
        second, third, fourth = first[width:], first[2 * width :], first[3 * width :]
        beside, below, into_x, into_y = fx[j:end], fy[j:end], out_x[j:end], out_y[j:end]
        for m in range(end - j):
            x, y = _weights(beside[m]), _weights(below[m])
            into_x[m] = share * _sum(_slopes(beside[m]), y, first, second, third, fourth, m)
            into_y[m] = share * _sum(x, _slopes(below[m]), first, second, third, fourth, m)
        j = end


@compiled
def warp(first, last, scene, motion, out):
    """Rows [first, last) of each frame: `out` (N, C, h, w) from the coefficients `scene` (1 or N, C, Hc, Wc)."""
    (frames, channels, h, w), (height, width) = out.shape, scene.shape[2:]
    at, ends = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy = np.empty(w, out.dtype), np.empty(w, out.dtype)
    for k in range(frames):
        for i in range(first, last):
            _locate(motion[k], i - (h - 1) / 2, height, width, at, ends, fx, fy)
            for c in range(channels):
                _combine(scene[k % len(scene), c].ravel(), width, at, ends, fx, fy, out[k, c, i])


@compiled
def warp_adjoint(first, last, gradient, motion, scene):
    """Rows [first, last) of the canvas `scene`, which is added to: the adjoint of `warp`."""
    (frames, channels, h, w), (height, width) = gradient.shape, scene.shape[2:]
    at, ends = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy = np.empty(w, scene.dtype), np.empty(w, scene.dtype)
    share = scene.dtype.type(1 / 36)
    # Room for three at both ends, so that each coefficient is written to once for all samples of a run.
    wx, wy = np.zeros((4, w + 6), scene.dtype), np.empty((4, w), scene.dtype)
    part = np.zeros(w + 6, scene.dtype)
    for k in range(frames):
        t = motion[k]
        for i in range(h):
            y = i - (h - 1) / 2
            low, high = _reach(t, y, w, height)
            if high < first - 3 or low > last + 2:
                continue  # the whole row looks elsewhere
            _locate(t, y, height, width, at, ends, fx, fy)
            for j in range(w):
                wx[0, j + 3], wx[1, j + 3], wx[2, j + 3], wx[3, j + 3] = _weights(fx[j])
                wy[0, j], wy[1, j], wy[2, j], wy[3, j] = _weights(fy[j])
            for c in range(channels):
                flat, row = scene[k % len(scene), c].ravel(), gradient[k, c, i]
                j = 0
                while j < w:
                    end = ends[j]
                    top, n = at[j] // width, end - j
                    g = row[j:end]
                    part[3 + n : 6 + n] = 0
                    p0, p1, p2, p3 = part[3:], part[2:], part[1:], part
                    x0, x1, x2, x3 = wx[0, j + 3 :], wx[1, j + 2 :], wx[2, j + 1 :], wx[3, j:]
                    for r in range(4):
                        if first <= top + r < last:
                            v, mine = wy[r, j:end], part[3 : 3 + n]
                            for m in range(n):
                                mine[m] = v[m] * g[m] * share
                            into = flat[at[j] + r * width :]
                            for m in range(n + 3):
                                into[m] += (x0[m] * p0[m] + x1[m] * p1[m]) + (x2[m] * p2[m] + x3[m] * p3[m])
                    j = end


@compiled
def grad_homography(first, last, gradient, scene, motion, sums):
    """The gradient of rows [first, last) in each row of the homographies: `sums` (N, h, 3, 2) of it, and of it by x."""
    (frames, channels, h, w), (height, width) = gradient.shape, scene.shape[2:]
    at, ends = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy = np.empty(w, scene.dtype), np.empty(w, scene.dtype)
    slope_x, slope_y = np.empty(w, scene.dtype), np.empty(w, scene.dtype)
    for k in range(frames):
        t = motion[k]
        for i in range(first, last):
            y = i - (h - 1) / 2
            _locate(t, y, height, width, at, ends, fx, fy)
            for c in range(channels):
                flat, row = scene[k % len(scene), c].ravel(), gradient[k, c, i]
                _combine_slopes(flat, width, at, ends, fx, fy, slope_x, slope_y)
                ax, ay, az, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
                for j in range(w):
                    x = j - (w - 1) / 2
                    px, py, depth, nearness = _project(t, x, y)
                    # Beyond the edge the scene is flat.
                    gx = row[j] * slope_x[j] * nearness if abs(px) < (width - 3) / 2 else 0.0
                    gy = row[j] * slope_y[j] * nearness if abs(py) < (height - 3) / 2 else 0.0
                    gz = gx * px + gy * py if depth >= MIN_DEPTH else 0.0
                    ax, ay, az = ax + gx, ay + gy, az - gz
                    bx, by, bz = bx + gx * x, by + gy * x, bz - gz * x
                into = sums[k, i]
                into[0, 0] += ax
                into[1, 0] += ay
                into[2, 0] += az
                into[0, 1] += bx
                into[1, 1] += by
                into[2, 1] += bz


@compiled
def grad_displacement(first, last, gradient, scene, points, out):
    """The gradient of rows [first, last) in the points (N, 2, h, w): `out`, of their shape."""
    (frames, channels, h, w), (height, width) = gradient.shape, scene.shape[2:]
    at, ends = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy = np.empty(w, scene.dtype), np.empty(w, scene.dtype)
    slope_x, slope_y = np.empty(w, scene.dtype), np.empty(w, scene.dtype)
    for k in range(frames):
        for i in range(first, last):
            y = i - (h - 1) / 2
            xs, vs = _row(points[k], y)
            _locate(points[k], y, height, width, at, ends, fx, fy)
            into_x, into_y = out[k, 0, i], out[k, 1, i]
            into_x[:], into_y[:] = 0, 0
            for c in range(channels):
                flat, row = scene[k % len(scene), c].ravel(), gradient[k, c, i]
                _combine_slopes(flat, width, at, ends, fx, fy, slope_x, slope_y)
                for j in range(w):
                    # Beyond the edge the scene is flat.
                    into_x[j] += row[j] * slope_x[j] if abs(xs[j]) < (width - 3) / 2 else ONE - ONE
                    into_y[j] += row[j] * slope_y[j] if abs(vs[j]) < (height - 3) / 2 else ONE - ONE


@compiled
def _part(t, y, count, height, width):
    """First, and last plus one, of `count` samples of a row that lie within the frame (`height`, `width`)."""
    first, last = count, 0
    for j in range(count):
        px, py, _, _ = _project(t, j - (count - 1) / 2, y)
        if abs(px) <= (width - 1) / 2 and abs(py) <= (height - 1) / 2:
            first, last = min(first, j), j + 1
    return first, last


@compiled
def mean(first, last, frames, weights, motion, out):
    """Rows [first, last) of the canvas `out` (H, W): the weighted mean of frames, zero where none has weight.

    Args:
        first, last: rows.
        frames: coefficients (1 or N, h, w).
        weights: (N, H, W), zero beyond the frames.
        motion: (N, 3, 3), from the canvas to the frames.
        out: written.
    """
    (height, width), (rows, columns) = frames.shape[1:], out.shape
    at, ends = np.empty((2, columns), np.int32)
    fx, fy, values, total = np.empty((4, columns), out.dtype)
    for r in range(first, last):
        y, moment = r - (rows - 1) / 2, out[r]
        moment[:], total[:] = 0, 0
        for k in range(len(weights)):
            start, end = _part(motion[k], y, columns, height, width)
            n, t = end - start, motion[k].copy()
            if n > 0:
                for row in t:
                    row[2] += row[0] * ((start + end - columns) / 2)  # of the part's centre
                _locate(t, y, height, width, at[:n], ends[:n], fx[:n], fy[:n])
                _combine(frames[k % len(frames)].ravel(), width, at[:n], ends[:n], fx[:n], fy[:n], values[:n])
                weight, known, part = weights[k, r, start:end], total[start:end], moment[start:end]
                for j in range(n):
                    known[j] += weight[j]
                    part[j] += weight[j] * values[j]
        for j in range(columns):
            moment[j] = moment[j] / total[j] if total[j] > 0 else ONE - ONE


@compiled
def warp_with_slopes(first, last, scene, motion, out):
    """Rows [first, last) of each frame of `out` (3, N, h, w): the coefficients `scene` (H, W), slopes along y and x."""
    (_, frames, h, w), (height, width) = out.shape, scene.shape
    at, ends = np.empty(w, np.int32), np.empty(w, np.int32)
    fx, fy, flat = np.empty(w, out.dtype), np.empty(w, out.dtype), scene.ravel()
    for k in range(frames):
        for i in range(first, last):
            _locate(motion[k], i - (h - 1) / 2, height, width, at, ends, fx, fy)
            _combine(flat, width, at, ends, fx, fy, out[0, k, i])
            _combine_slopes(flat, width, at, ends, fx, fy, out[2, k, i], out[1, k, i])
