"""Shifts in whole px, out of all that there are: where the likelihood's climb may begin."""

from __future__ import annotations

import numpy as np
from torch import Tensor

from deepir.registration.shift_likelihood import ShiftLikelihood

MIN_WAVENUMBER = (
    0.2  # rad per px; longer waves change more by what leaves the frame than the guessed noise allows
)
MAX_SWEEPS = 4  # sweeps over all frames


def integer_shifts(frames: Tensor) -> np.ndarray:
    """Shifts `(N - 1, 2)` (x, y) in px of frames `(N, h, w)`, relative to the first: frame by frame the likeliest.

    What a wave of two frames says of the angle `k d` between them has a first harmonic, and the sum of those over all
    waves, for all shifts d at once, is a Fourier transform: a correlation in which scene, pattern and noise have their
    weights. The powers are guessed. At lag zero the pattern is with itself, whatever its weight: that lag is left out.
    """
    likelihood = ShiftLikelihood(frames)
    h, w = likelihood.size
    shifts, is_placed = np.zeros((len(frames), 2), int), np.arange(len(frames)) == 0
    for _ in range(MAX_SWEEPS):
        previous = shifts.copy()
        for k in range(1, len(frames)):
            other_frames = is_placed & (np.arange(len(frames)) != k)
            scores = np.fft.irfft2(first_harmonic(likelihood, k, other_frames, shifts), s=(h, w))
            scores[shifts[other_frames, 1], shifts[other_frames, 0]] = np.inf
            y, x = np.unravel_index(scores.argmin(), scores.shape)
            shifts[k] = (x + w // 2) % w - w // 2, (y + h // 2) % h - h // 2
            is_placed[k] = True
        if (shifts == previous).all():
            break
    return shifts[1:].astype(float)


def first_harmonic(
    likelihood: ShiftLikelihood, k: int, other_frames: np.ndarray, all_shifts: np.ndarray
) -> np.ndarray:
    """What frame k says beside each of the others, which are at their places: minus log-likelihood, `(h, w / 2 + 1)`.

    The two frames' covariance has the determinant `p - q cos(k d)`, whose logarithm and inverse are series in `ratio`.
    """
    scene, pattern, noise = likelihood.scene, likelihood.pattern, likelihood.noise
    cross = 2 * scene * pattern
    remainder = noise * (noise + 2 * (scene + pattern))
    root = np.sqrt(remainder * (remainder + 2 * cross))
    ratio = cross / (remainder + cross + root)
    shifts, frame = all_shifts[other_frames], likelihood.frames[k]
    back_y, back_x = np.exp(-1j * shifts[:, 1:] * likelihood.y), np.exp(-1j * shifts[:, :1] * likelihood.x)
    phase = back_y[:, :, None] * back_x[:, None]
    other_spectra = likelihood.frames[other_frames]
    ahead, behind = (
        (other_spectra.conj() * phase).sum(0) * frame,
        (other_spectra * phase).sum(0) * frame.conj(),
    )
    power = (phase * (np.abs(other_spectra) ** 2 + np.abs(frame) ** 2)).sum(0)
    explained = (pattern + scene * ratio) * ratio * ahead + (pattern * ratio + scene) * behind
    values = ((scene + pattern + noise) * ratio * power - explained) / root - ratio * phase.sum(0)
    harmonic = np.zeros((likelihood.size[0], likelihood.size[1] // 2 + 1), complex)
    harmonic[likelihood.band] = np.where(likelihood.wavenumber < MIN_WAVENUMBER, 0, values)
    return harmonic
