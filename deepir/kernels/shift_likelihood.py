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
            expected[r, kind[r, c], 1] += unsure * (n * (a + b) - 2 * _power(both[c]))
            for j in range(n):
                expected[r, kind[r, c], 1] += _power(frames[j, r, c] - p[c] - turn[j, c] * s[c])


@compiled
def _solve_row(r, frames, by_y, by_x, scene, pattern, noise, turn, waves, det):
    """Of a row: turns, the frames' sum as they are and moved back, off-diagonal and (real) determinant of the normal
    equations, and their solution, scene and pattern; by differences, since of frames at rest all else cancels."""
    n, _, w = frames.shape
    same, moved, both, s, p = waves
    waves[:3], det[:] = 0.0, 0.0
    for j in range(n):
        for c in range(w):
            turn[j, c] = by_y[j, r] * by_x[j, c]
            back, apart = turn[j, c].conjugate() - 1, frames[j, r, c] - frames[0, r, c]
            same[c] += apart
            moved[c] += back * apart
            both[c] += back
            det[c] += _power(back)
    for c in range(w):
        of_scene, of_pattern, one = noise[r, c] / scene[r, c], noise[r, c] / pattern, 1 / n
        spread, apart = det[c] - one * _power(both[c]), moved[c] - one * both[c] * same[c]
        both[c] += n
        same[c] += n * frames[0, r, c]
        moved[c] = apart + one * both[c] * same[c]
        det[c] = n * (spread + of_scene + of_pattern) + of_scene * of_pattern
        s[c] = (of_pattern * moved[c] + n * apart) * (1 / det[c])
        p[c] = ((of_scene + spread) * same[c] - both[c].conjugate() * apart) * (1 / det[c])


@compiled
def _power(value):
    return value.real**2 + value.imag**2
