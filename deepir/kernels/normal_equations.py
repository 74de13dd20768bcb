# mypy: disable-error-code="no-untyped-def"
"""Residuals weighted, and the normal equations of gain and offset solved."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled

DETERMINANTS_PER_LOG = 8  # determinants that are multiplied before one logarithm is taken
ROWS_PER_BAND = 32  # rows of a band, the unit of parallel work
PIXELS_PER_BLOCK = 512  # pixels whose sums stay in the cache


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


@compiled
def negative_log_likelihood(first, last, values, counts, u, v, sums):
    """Sums over those of the values (aa, ab, bb, s, t), (5, K), that count (K,), for variances u and v: `sums` (6,).

    Of `log det(1 + A V) - s' V (1 + A V)^-1 s`, of its slope in u and v, and of its curvature (uu, uv, vv).
    """
    nats, by_u, by_v, by_uu, by_uv, by_vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for start in range(0, values.shape[1], DETERMINANTS_PER_LOG):
        product = 1.0
        for k in range(start, min(start + DETERMINANTS_PER_LOG, values.shape[1])):
            aa, ab, bb, s, t = values[0, k], values[1, k], values[2, k], values[3, k], values[4, k]
            one, whole = 1.0 if counts[k] else 0.0, aa * bb - ab * ab
            system = 1 + u * aa + v * bb + u * v * whole
            # (1 + A V)^-1 times A, and times s.
            scale = one / system
            p, q, r = (aa + v * whole) * scale, ab * scale, (bb + u * whole) * scale
            x, y = (s + v * (bb * s - ab * t)) * scale, (t + u * (aa * t - ab * s)) * scale
            product *= system if counts[k] else 1.0
            nats -= u * s * x + v * t * y
            by_u, by_v = by_u + p - x * x, by_v + r - y * y
            by_uu += p * (2 * x * x - p)
            by_uv += q * (2 * x * y - q)
            by_vv += r * (2 * y * y - r)
        nats += np.log(product)
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = nats, by_u, by_v, by_uu, by_uv, by_vv


@compiled
def reduce(first, last, flux, data, precision, level, neutral, u, v, maps, across, down, nats):
    """`maps` (5, h, w) of frames (N, h, w), their sums `across` each row (5, h) and `down` each band (bands, 5, w).

    Each band's half of the logarithm of the determinants goes to `nats` (bands,).
    """
    frames, height, width = flux.shape
    block, whole_system = np.empty((5, PIXELS_PER_BLOCK)), np.empty(PIXELS_PER_BLOCK)
    aa, ab, bb, sa, sb = block[0], block[1], block[2], block[3], block[4]
    for band in range(first, last):
        down[band], nats[band] = 0, 0
        for i in range(band * ROWS_PER_BAND, min(band * ROWS_PER_BAND + ROWS_PER_BAND, height)):
            across[:, i] = 0
            for start in range(0, width, PIXELS_PER_BLOCK):
                stop = min(start + PIXELS_PER_BLOCK, width)
                block[:] = 0
                m = flux[0, i, start:stop]
                for k in range(frames):
                    z, y, w = flux[k, i, start:stop], data[k, i, start:stop], precision[k, i, start:stop]
                    less = level[k]
                    for j in range(stop - start):
                        flow, weight = np.float64(z[j]), np.float64(w[j])
                        d, rest = flow - m[j], y[j] - neutral * flow - less
                        wd = weight * d
                        aa[j] += wd * d
                        ab[j] += wd
                        bb[j] += weight
                        sa[j] += wd * rest
                        sb[j] += weight * rest
                s0, s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0, 0.0
                m0, m1, m2 = maps[0, i, start:stop], maps[1, i, start:stop], maps[2, i, start:stop]
                m3, m4 = maps[3, i, start:stop], maps[4, i, start:stop]
                d0, d1, d2 = down[band, 0, start:stop], down[band, 1, start:stop], down[band, 2, start:stop]
                d3, d4 = down[band, 3, start:stop], down[band, 4, start:stop]
                for j in range(stop - start):
                    shift = np.float64(m[j])
                    shifted = ab[j] + shift * bb[j]
                    whole = aa[j] + shift * (ab[j] + shifted)
                    determinant, cross = aa[j] * bb[j] - ab[j] * ab[j], sa[j] * bb[j] - sb[j] * ab[j]
                    lower = bb[j] + u * determinant
                    whole_system[j] = 1 + u * whole + v * lower
                    scale = 1 / whole_system[j]
                    p0, p1, p2 = (whole + v * determinant) * scale, shifted * scale, lower * scale
                    p3 = (sa[j] + shift * sb[j] + v * cross) * scale
                    p4 = (sb[j] + u * (sb[j] * aa[j] - sa[j] * ab[j] - shift * cross)) * scale
                    m0[j], m1[j], m2[j], m3[j], m4[j] = p0, p1, p2, p3, p4
                    d0[j], d1[j], d2[j], d3[j], d4[j] = (d0[j] + p0, d1[j] + p1, d2[j] + p2, d3[j] + p3, d4[j] + p4)
                    s0, s1, s2, s3, s4 = s0 + p0, s1 + p1, s2 + p2, s3 + p3, s4 + p4
                for j in range(0, stop - start, DETERMINANTS_PER_LOG):
                    product = 1.0
                    for k in range(j, min(j + DETERMINANTS_PER_LOG, stop - start)):
                        product *= whole_system[k]
                    nats[band] += np.log(product) / 2
                across[0, i] += s0
                across[1, i] += s1
                across[2, i] += s2
                across[3, i] += s3
                across[4, i] += s4


@compiled
def _copy(values, into):
    """As many as there is room for. A slice that is set to another takes two seconds to compile."""
    for i in range(len(into)):
        into[i] = values[i]


@compiled
def _multiply_row_coupling(maps, root, to_columns, to_rows, weights, x, rest, columns, rows, out):
    """What the rows do to white columns and terms `x`, from which they start at `rest`: `out`; the others are room."""
    height, width = maps.shape[1:]
    terms, a, b = x[2 * width :], columns[:width], columns[width:]
    _copy(x, columns)
    _copy(rest, rows)
    for t in range(len(terms)):
        value, in_columns, in_rows = terms[t], to_columns[t], to_rows[t]
        for j in range(2 * width):
            columns[j] -= value * in_columns[j]
        for i in range(2 * height):
            rows[i] += value * in_rows[i]
    for j in range(width):
        a[j], b[j] = root[0, 0, j] * a[j] + root[1, 0, j] * b[j], root[0, 1, j] * a[j] + root[1, 1, j] * b[j]
    out[:] = 0
    down, also_down = out[:width], out[width : 2 * width]
    for i in range(height):
        aa, ab, bb, c, d = maps[0, i], maps[1, i], maps[2, i], rows[i], rows[height + i]
        for j in range(width):
            c += aa[j] * a[j] + ab[j] * b[j]
            d += ab[j] * a[j] + bb[j] * b[j]
        c, d = weights[0, i] * c + weights[1, i] * d, weights[1, i] * c + weights[2, i] * d
        rows[i], rows[height + i] = c, d
        for j in range(width):
            down[j] += aa[j] * c + ab[j] * d
            also_down[j] += ab[j] * c + bb[j] * d
    for j in range(width):
        c, d = down[j], also_down[j]
        down[j] = root[0, 0, j] * c + root[0, 1, j] * d
        also_down[j] = root[1, 0, j] * c + root[1, 1, j] * d
    for t in range(len(terms)):
        total, in_columns, in_rows = 0.0, to_columns[t], to_rows[t]
        for i in range(2 * height):
            total += in_rows[i] * rows[i]
        for j in range(2 * width):
            total -= in_columns[j] * out[j]
        out[2 * width + t] = total


@compiled
def solve(first, last, maps, root, to_columns, to_rows, weights, rest, tolerance, iterations, x):
    """Conjugate gradients, whole; `x` is the right-hand side, and becomes the solution."""
    columns, rows, nothing = np.empty(2 * maps.shape[2]), np.empty(2 * maps.shape[1]), np.zeros(2 * maps.shape[1])
    p, q, r, rr = np.zeros(len(x)), np.empty(len(x)), np.empty(len(x)), 0.0
    _multiply_row_coupling(maps, root, to_columns, to_rows, weights, p, rest, columns, rows, q)
    for k in range(len(x)):  # one by one: operations on whole arrays take long to compile
        r[k] = x[k] - q[k]
        p[k], x[k] = r[k], 0 * r[k]  # what is not a number stays so
        rr += r[k] * r[k]
    goal = tolerance * tolerance * rr
    for _ in range(iterations):
        if not rr > goal:
            break
        _multiply_row_coupling(maps, root, to_columns, to_rows, weights, p, nothing, columns, rows, q)
        along = 0.0
        for k in range(len(x)):
            q[k] = p[k] - q[k]
            along += p[k] * q[k]
        step, before, rr = rr / along, rr, 0.0
        for k in range(len(x)):
            x[k] += step * p[k]
            r[k] -= step * q[k]
            rr += r[k] * r[k]
        for k in range(len(x)):
            p[k] = r[k] + (rr / before) * p[k]


@compiled
def back_substitute(
    first, last, maps, columns, rest, weights, along, in_x, sigma, neutral, errors, gain, offset, values
):
    """White pixel values `gain` and `offset` (h, w), the `errors` that the rows solve (2, h), and the `values`."""
    height, width = maps.shape[1:]
    x, y = np.empty(width), np.empty(width)
    for i in range(first * ROWS_PER_BAND, min(last * ROWS_PER_BAND, height)):
        aa, ab, bb, sa, sb = maps[0, i], maps[1, i], maps[2, i], maps[3, i], maps[4, i]
        _copy(columns[0], x)
        _copy(columns[1], y)
        for p in range(len(in_x)):
            x_p, a, b = in_x[p], along[0, i, p], along[1, i, p]
            for j in range(width):
                x[j] += a * x_p[j]
                y[j] += b * x_p[j]
        a, b = rest[0, i], rest[1, i]
        for j in range(width):
            a -= aa[j] * x[j] + ab[j] * y[j]
            b -= ab[j] * x[j] + bb[j] * y[j]
        errors[0, i], errors[1, i] = a, b
        a, b = weights[0, i] * a + weights[1, i] * b, weights[1, i] * a + weights[2, i] * b
        into_x, into_y, all_x, all_y = gain[i], offset[i], values[0, i], values[1, i]
        for j in range(width):
            px, py = x[j] + a, y[j] + b
            wx = sigma[0] * (sa[j] - (aa[j] * px + ab[j] * py))
            wy = sigma[1] * (sb[j] - (ab[j] * px + bb[j] * py))
            into_x[j], into_y[j] = wx, wy
            all_x[j] = neutral[0] + px + sigma[0] * wx
            all_y[j] = neutral[1] + py + sigma[1] * wy
