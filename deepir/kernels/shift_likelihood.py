# mypy: disable-error-code="no-untyped-def"
"""The likelihood of shifts, wave by wave: see `deepir.registration.shift_likelihood`.

Frames are waves, (N, h, w) complex; the powers of scene and noise are (h, w), that of the pattern is one number. Waves
of a frame turn by the product of `by_y`, (N, h), and `by_x`, (N, w), complex of magnitude one.
"""

from __future__ import annotations

import math

import numpy as np

from deepir.kernels.compile import compiled


@compiled
def negative_log_likelihood(first, last, frames, by_y, by_x, scene, pattern, noise, y, x, found, slope):
    """Rows [first, last): their parts of minus the log-likelihood, (h,), and of its slope, (h, N, 2)."""
    turn, waves, det = np.empty(by_x.shape, np.complex128), np.empty((5, len(x)), np.complex128), np.empty(len(x))
    for r in range(first, last):
        _solve_row(r, frames, by_y, by_x, scene, pattern, noise, turn, waves, det)
        same, moved, both, s, p = waves
        found[r] = 0.0
        for c in range(len(x)):
            found[r] += math.log(det[c]) - (moved[c] * s[c].conjugate() + same[c] * p[c].conjugate()).real / noise[r, c]
            s[c] *= 1 / noise[r, c]
            both[c] *= 1 / det[c]
        for j in range(len(frames)):
            along = across = 0.0
            for c in range(len(x)):
                pull = (((frames[j, r, c] - p[c]).conjugate() * s[c] + both[c]) * turn[j, c]).imag
                along += pull * x[c]
                across += pull
            slope[r, j, 0], slope[r, j, 1] = 2 * along, 2 * across * y[r]


@compiled
def expected_powers(first, last, frames, by_y, by_x, scene, pattern, noise, kind, expected, white):
    """Rows [first, last): expected squares of scene and noise, summed over waves of a kind, (h, kinds, 2).

    The kind of a wave is in (h, w); the pattern's, which is of one kind, are in `white`, (h,).
    """
    n, _, w = frames.shape
    turn, waves, det = np.empty((n, w), np.complex128), np.empty((5, w), np.complex128), np.empty(w)
    for r in range(first, last):
        _solve_row(r, frames, by_y, by_x, scene, pattern, noise, turn, waves, det)
        _, _, both, s, p = waves
        expected[r], white[r] = 0.0, 0.0
        for c in range(w):
            a, b, unsure = n + noise[r, c] / scene[r, c], n + noise[r, c] / pattern, noise[r, c] / det[c]
            white[r] += _power(p[c]) + unsure * a
            expected[r, kind[r, c], 0] += _power(s[c]) + unsure * b
            left = unsure * (n * (a + b) - 2 * _power(both[c]))
            for j in range(n):
                left += _power(frames[j, r, c] - p[c] - turn[j, c] * s[c])
            expected[r, kind[r, c], 1] += left


@compiled
def _solve_row(r, frames, by_y, by_x, scene, pattern, noise, turn, waves, det):
    """Of a row: turns, the frames' sum as they are and moved back, the normal equations' off-diagonal and (real)
    determinant, and their solution, scene and pattern."""
    n, _, w = frames.shape
    same, moved, both, s, p = waves
    waves[:3] = 0.0
    for j in range(n):
        for c in range(w):
            turn[j, c] = by_y[j, r] * by_x[j, c]
            same[c] += frames[j, r, c]
            moved[c] += turn[j, c].conjugate() * frames[j, r, c]
            both[c] += turn[j, c].conjugate()
    for c in range(w):
        a, b = n + noise[r, c] / scene[r, c], n + noise[r, c] / pattern
        det[c] = a * b - _power(both[c])
        s[c] = (b * moved[c] - both[c] * same[c]) * (1 / det[c])
        p[c] = (a * same[c] - both[c].conjugate() * moved[c]) * (1 / det[c])


@compiled
def _power(value):
    return value.real**2 + value.imag**2
