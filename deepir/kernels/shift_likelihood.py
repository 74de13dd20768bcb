# mypy: disable-error-code="no-untyped-def"
"""The likelihood of shifts, wave by wave: see `deepir.registration.shift_likelihood`.

Frames are real and imaginary parts of waves, (N, h, w) each, of lengths y (h,) and x (w,); the powers of scene and
noise are (h, w), that of the pattern is one number; shifts (N, 2) are x and y, as waves of all frames turn by.
"""

from __future__ import annotations

import math

import numpy as np

from deepir.kernels.compile import compiled

#: Products of determinants stay below this and above its inverse; beyond, their logarithm is taken.
MAX_PRODUCT = 1e200


@compiled
def negative_log_likelihood(first, last, real, imag, shifts, y, x, scene, pattern, noise, found, slope):
    """Rows [first, last): their parts of minus the log-likelihood, (h,), and of its slope, (h, N, 2)."""
    cosine, sine, turn, waves = _phase_tables(real, shifts, x)
    for r in range(first, last):
        _solve_row(r, real, imag, shifts, y, scene, pattern, noise, cosine, sine, turn, waves)
        same, moved, both, det, s, p = waves
        total, product = 0.0, 1.0
        for c in range(len(x)):
            one, each = 1 / det[0, c], 1 / noise[r, c]
            explained = moved[0, c] * s[0, c] + moved[1, c] * s[1, c]
            total -= (explained + same[0, c] * p[0, c] + same[1, c] * p[1, c]) * each
            both[0, c] *= one
            both[1, c] *= one
            s[0, c] *= each
            s[1, c] *= each
        for c in range(len(x)):
            product *= det[0, c]
            if not 1 / MAX_PRODUCT < product < MAX_PRODUCT:
                total += math.log(product)
                product = 1.0
        found[r] = total + math.log(product)
        for j in range(len(real)):
            u, v, along, across = turn[0, j], turn[1, j], 0.0, 0.0
            for c in range(len(x)):
                less, more = real[j, r, c] - p[0, c], imag[j, r, c] - p[1, c]
                pull = (less * s[0, c] + more * s[1, c] + both[0, c]) * v[c]
                pull += (less * s[1, c] - more * s[0, c] + both[1, c]) * u[c]
                along += pull * x[c]
                across += pull
            slope[r, j, 0], slope[r, j, 1] = 2 * along, 2 * across * y[r]


@compiled
def expected_powers(first, last, real, imag, shifts, y, x, scene, pattern, noise, kind, expected, white):
    """Rows [first, last): expected squares of scene and noise, summed over waves of a kind, (h, kinds, 2).

    The kind of a wave is in (h, w); the pattern's, which is of one kind, are in `white`, (h,).
    """
    cosine, sine, turn, waves = _phase_tables(real, shifts, x)
    n = len(real)
    for r in range(first, last):
        _solve_row(r, real, imag, shifts, y, scene, pattern, noise, cosine, sine, turn, waves)
        _, left, both, det, s, p = waves
        left[0] = 0.0
        for j in range(n):
            u, v = turn[0, j], turn[1, j]
            for c in range(len(x)):
                less = real[j, r, c] - p[0, c] - u[c] * s[0, c] + v[c] * s[1, c]
                more = imag[j, r, c] - p[1, c] - u[c] * s[1, c] - v[c] * s[0, c]
                left[0, c] += less * less + more * more
        expected[r], white[r] = 0.0, 0.0
        for c in range(len(x)):
            a, b, unsure = n + noise[r, c] / scene[r, c], n + noise[r, c] / pattern, noise[r, c] / det[0, c]
            shared = both[0, c] ** 2 + both[1, c] ** 2
            white[r] += p[0, c] ** 2 + p[1, c] ** 2 + unsure * a
            expected[r, kind[r, c], 0] += s[0, c] ** 2 + s[1, c] ** 2 + unsure * b
            expected[r, kind[r, c], 1] += left[0, c] + unsure * (n * (a + b) - 2 * shared)


@compiled
def _phase_tables(real, shifts, x):
    """Cosine and sine of what shifts along x turn waves by, (N, w) each; room for all turns, and for a row's waves."""
    n, _, w = real.shape
    cosine, sine = np.empty((n, w)), np.empty((n, w))
    for j in range(n):
        for c in range(w):
            cosine[j, c], sine[j, c] = math.cos(shifts[j, 0] * x[c]), math.sin(shifts[j, 0] * x[c])
    return cosine, sine, np.empty((2, n, w)), np.empty((6, 2, w))


@compiled
def _solve_row(r, real, imag, shifts, y, scene, pattern, noise, cosine, sine, turn, waves):
    """Of a row: turns, and as real and imaginary parts the frames' sum as they are and moved back, the normal
    equations' off-diagonal and (real) determinant, and their solution, scene and pattern."""
    n, _, w = real.shape
    same, moved, both, det, s, p = waves
    same[:], moved[:], both[:] = 0.0, 0.0, 0.0
    for j in range(n):
        cr, ci = math.cos(shifts[j, 1] * y[r]), math.sin(shifts[j, 1] * y[r])
        u, v, re, im = turn[0, j], turn[1, j], real[j, r], imag[j, r]
        for c in range(w):
            u[c] = cr * cosine[j, c] - ci * sine[j, c]
            v[c] = cr * sine[j, c] + ci * cosine[j, c]
            same[0, c] += re[c]
            same[1, c] += im[c]
            moved[0, c] += u[c] * re[c] + v[c] * im[c]
            moved[1, c] += u[c] * im[c] - v[c] * re[c]
            both[0, c] += u[c]
            both[1, c] -= v[c]
    for c in range(w):
        a, b = n + noise[r, c] / scene[r, c], n + noise[r, c] / pattern
        det[0, c] = a * b - both[0, c] ** 2 - both[1, c] ** 2
        one = 1 / det[0, c]
        s[0, c] = (b * moved[0, c] - both[0, c] * same[0, c] + both[1, c] * same[1, c]) * one
        s[1, c] = (b * moved[1, c] - both[0, c] * same[1, c] - both[1, c] * same[0, c]) * one
        p[0, c] = (a * same[0, c] - both[0, c] * moved[0, c] - both[1, c] * moved[1, c]) * one
        p[1, c] = (a * same[1, c] - both[0, c] * moved[1, c] + both[1, c] * moved[0, c]) * one
