"""Shifts in whole px, out of all that there are: where the likelihood's climb may begin."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from deepir.registration.shift_likelihood import Spectra

SLOWEST = 0.2  # radians a px: of longer waves more leaves the frame than what their noise is guessed to be
PASSES = 4  # over all frames, at most


def integer_shifts(frames: Tensor) -> np.ndarray:
    """Shifts `(N - 1, 2)` (x, y) in px of frames `(N, h, w)`, relative to the first: frame by frame the likeliest.

    What a wave of two frames says of the angle `k d` between them has a first harmonic, and the sum of those over all
    waves, for all shifts d at once, is a Fourier transform: a correlation in which scene, pattern and noise have their
    weights. The powers are guessed. At lag zero the pattern is with itself, whatever its weight: that lag is left out.
    """
    spectra = Spectra(frames)
    h, w = spectra.size
    at, placed = np.zeros((len(frames), 2), int), np.arange(len(frames)) == 0
    for _ in range(PASSES):
        before = at.copy()
        for k in range(1, len(frames)):
            others = placed & (np.arange(len(frames)) != k)
            nats = np.fft.irfft2(first_harmonic(spectra, k, others, at), s=(h, w))
            nats[at[others, 1], at[others, 0]] = np.inf
            y, x = np.unravel_index(nats.argmin(), nats.shape)
            at[k] = (x + w // 2) % w - w // 2, (y + h // 2) % h - h // 2
            placed[k] = True
        if (at == before).all():
            break
    return at[1:].astype(float)


def first_harmonic(spectra: Spectra, k: int, others: np.ndarray, at: np.ndarray) -> np.ndarray:
    """What frame k says beside each of the others, which are at their places: minus log-likelihood, `(h, w / 2 + 1)`.

    The two frames' covariance has the determinant `p - q cos(k d)`, whose logarithm and inverse are series in `ratio`.
    """
    scene, pattern, noise = spectra.scene, spectra.pattern, spectra.noise
    cross = 2 * scene * pattern
    rest = noise * (noise + 2 * (scene + pattern))
    root = np.sqrt(rest * (rest + 2 * cross))
    ratio = cross / (rest + cross + root)
    shifts, frame = at[others], spectra.frames[k]
    back_y, back_x = np.exp(-1j * shifts[:, 1:] * spectra.y), np.exp(-1j * shifts[:, :1] * spectra.x)
    turn = back_y[:, :, None] * back_x[:, None]
    there = spectra.frames[others]
    ahead, behind = (there.conj() * turn).sum(0) * frame, (there * turn).sum(0) * frame.conj()
    power = (turn * (np.abs(there) ** 2 + np.abs(frame) ** 2)).sum(0)
    explained = (pattern + scene * ratio) * ratio * ahead + (pattern * ratio + scene) * behind
    found = ((scene + pattern + noise) * ratio * power - explained) / root - ratio * turn.sum(0)
    whole = np.zeros((spectra.size[0], spectra.size[1] // 2 + 1), complex)
    whole[spectra.known] = np.where(spectra.length < SLOWEST, 0, found)
    return whole
