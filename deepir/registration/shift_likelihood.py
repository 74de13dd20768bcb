"""Shifts of all frames at once, by their likelihood: scene and pattern, Gaussian of unknown spectra, integrated out.

A wave k of frame j is `F_j = exp(i k d_j) X + P + noise`, of a scene X with a power that is that of all waves as long,
and a pattern P, whose power is one number. Noise, too, has a power for each length: what leaves the frame or walks
through it is in there. Waves along rows and columns are not asked: the pattern's lines are in them, and a scene's slope
or horizon, which then passes for lines. Where a plain scene hides under its pattern, this finds the frames' places
where correlations and residuals are ruled by the pattern. (Expectation-maximisation for the powers: Dempster, Laird,
Rubin 1977.)


Shifts in whole px, out of all that there are: where the likelihood's climb may begin."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.registration.cross_correlation import hann_window

MAX_WAVENUMBER = 2.5  # rad per px; shorter waves hold almost no scene
N_RINGS = 14  # rings of waves of about one length, each with one power of scene and one of noise
AXIS_EXCLUSION = (
    2.5  # cycles per frame; waves up to here along an axis hold the pattern's lines, by the taper's leakage
)
CONVERGED_SHIFT = 0.05  # px; a smaller step ends the alternation of shifts and powers
MAX_ALTERNATIONS = 3  # of shifts and powers
MAX_LBFGS_STEPS = 20  # L-BFGS steps of the shifts at fixed powers
EM_ITERATIONS = 6  # expectation-maximisation steps of the powers at fixed shifts
GRADIENT_TOLERANCE = 1.0  # nats per px; a smaller gradient ends L-BFGS

MIN_WAVENUMBER = (
    0.2  # rad per px; longer waves change more by what leaves the frame than the guessed noise allows
)
MAX_SWEEPS = 4  # sweeps over all frames


class Likelihood(Protocol):
    """Of places `(K, P)`, under powers that are unknown, too."""

    def negative_log_likelihood(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of places `(K P)`, less what does not depend on them; and its gradient."""

    def update_powers(self, parameters: np.ndarray) -> None:
        """The powers that are likeliest at places `(K, P)`, nearly."""


def maximise(likelihood: Likelihood, parameters: np.ndarray) -> np.ndarray:
    """The places `(K, P)` to which the likelihood climbs from a start `(K, P)`; all in px."""
    options = {"maxiter": MAX_LBFGS_STEPS, "gtol": GRADIENT_TOLERANCE}
    for _ in range(MAX_ALTERNATIONS):
        result = minimize(
            likelihood.negative_log_likelihood,
            parameters.ravel(),
            jac=True,
            method="L-BFGS-B",
            options=options,
        )
        previous, parameters = parameters, result.x.reshape(parameters.shape)
        if np.abs(parameters - previous).max() < CONVERGED_SHIFT:
            break
        likelihood.update_powers(parameters)
    return parameters


def maximise_shift_likelihood(frames: Tensor, start: np.ndarray) -> np.ndarray:
    """Shifts `(N - 1, 2)` (x, y) in px of frames `(N, h, w)`, relative to the first, from a start `(N - 1, 2)`."""
    return maximise(ShiftLikelihood(frames), start)


class ShiftLikelihood:
    """The frames' long waves `(N, h, w)`, the powers `(h, w)` of scene and noise, and the pattern's."""

    def __init__(self, frames: Tensor) -> None:
        h, w = frames.shape[1:]
        taper = hann_window(h, w).double()
        frames = (frames - (frames * taper).sum((1, 2), keepdim=True) / taper.sum()) * taper
        y, x = (2 * np.pi * waves for waves in (np.fft.fftfreq(h), np.fft.rfftfreq(w)))
        rows, columns = (
            (AXIS_EXCLUSION * 2 * np.pi / side < np.abs(each)) & (np.abs(each) < MAX_WAVENUMBER)
            for side, each in ((h, y), (w, x))
        )
        self.y, self.x = y[rows], x[columns]
        self.size, self.band = (h, w), np.ix_(rows, columns)
        spectra = torch.fft.rfft2(frames).numpy() / float(taper.square().sum().sqrt())
        self.frames = spectra[:, rows][:, :, columns]
        self.real, self.imag = (np.ascontiguousarray(each) for each in (self.frames.real, self.frames.imag))
        self.wavenumber = np.hypot(self.y[:, None], self.x)
        self.ring = np.digitize(self.wavenumber, np.geomspace(2 * np.pi / max(h, w), MAX_WAVENUMBER, N_RINGS))
        self.ring_sizes = np.bincount(self.ring.ravel(), minlength=N_RINGS + 1)
        self._set_initial_powers(self.wavenumber > 0.8 * MAX_WAVENUMBER)

    def _set_initial_powers(self, high_band: np.ndarray) -> None:
        """Of the shortest waves, what differs from frame to frame is noise, and what does not is pattern."""
        n = len(self.frames)
        power = (np.abs(self.frames) ** 2).mean(0)
        temporal_variance = (np.abs(self.frames - self.frames.mean(0)) ** 2).sum(0) / (n - 1)
        self.noise_floor = 1e-9 * float(power.mean())  # frames may be identical
        noise = max(float(temporal_variance[high_band].mean()), self.noise_floor)
        median_to_mean = 1 / np.log(
            2
        )  # a wave's power has an exponential distribution: its mean from its median
        pattern = max(median_to_mean * float(np.median(power[high_band])) - noise, 0.1 * noise)
        total = np.bincount(self.ring.ravel(), power.ravel(), N_RINGS + 1)
        self.scene = np.maximum(
            (total / np.maximum(self.ring_sizes, 1))[self.ring] - pattern - noise, 0.02 * pattern
        )
        self.pattern, self.noise = pattern, np.full(power.shape, noise)

    def negative_log_likelihood(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of shifts `(2 (N - 1))`, less what does not depend on them; and its gradient."""
        from deepir.kernels.shift_likelihood import nats

        rows = len(self.y)
        values, gradient = np.empty(rows), np.empty((rows, len(self.real), 2))
        nats(0, rows, *self._kernel_arguments(shifts.reshape(-1, 2)), values, gradient)
        return float(values.sum()), gradient.sum(0)[1:].ravel()

    def update_powers(self, shifts: np.ndarray) -> None:
        """The powers that are likeliest at shifts `(N - 1, 2)`, nearly."""
        from deepir.kernels.shift_likelihood import powers

        n, rows = len(self.real), len(self.y)
        expected, pattern_powers = np.empty((rows, N_RINGS + 1, 2)), np.empty(rows)
        for _ in range(EM_ITERATIONS):
            powers(0, rows, *self._kernel_arguments(shifts), self.ring, expected, pattern_powers)
            scene, noise = (expected.sum(0) / np.maximum(self.ring_sizes, 1)[:, None]).T
            self.scene, self.noise = scene[self.ring], np.maximum(noise / n, self.noise_floor)[self.ring]
            self.pattern = float(pattern_powers.sum()) / self.ring.size

    def _kernel_arguments(self, shifts: np.ndarray) -> tuple[Any, ...]:
        """What the loops take, at shifts `(N - 1, 2)`: all rows at once, which are too few to share among threads."""
        all_shifts = np.vstack((np.zeros((1, 2)), shifts))
        return self.real, self.imag, all_shifts, self.y, self.x, self.scene, self.pattern, self.noise


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
