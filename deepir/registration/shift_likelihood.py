"""Marginal likelihood of the shifts of all frames; scene and fixed pattern are integrated out.

Wave k of frame j is `F_j(k) = exp(i k d_j) X(k) + P(k) + noise`, with shift d_j. The scene X and the pattern P are
Gaussian; so is the noise, which includes what leaves the frame or moves in it. The powers of scene and noise depend on
the wavenumber only (one value per ring), that of the pattern is one number. Powers are estimated by
expectation-maximisation, in turn with the shifts. Waves along rows and columns are left out: they contain the lines of
the pattern, and slopes and horizons of the scene look like such lines.

In weakly textured scenes under a strong pattern this finds the shifts where the pattern dominates correlations and
residuals. `integer_shifts` finds initial values by exhaustive search, `maximise_shift_likelihood` refines them.

Source: Dempster, Laird and Rubin, Maximum likelihood from incomplete data via the EM algorithm, JRSS B 39 (1977).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.registration.cross_correlation import hann_window

MAX_SWEEPS = 4  # sweeps of the integer search over all frames


@dataclass(frozen=True)
class WaveSelection:
    """Which waves of the frames' spectra the likelihood uses."""

    max_wavenumber: float = 2.5  # rad per px; shorter waves hold almost no scene
    axis_exclusion: float = 2.5  # cycles per frame from either axis, to which the taper spreads lines
    n_rings: int = 14  # rings of waves of about one length, each with one power of scene and one of noise
    high_band: float = 0.8  # of the largest wavenumber; shorter waves: initial powers of noise and pattern
    min_wavenumber: float = 0.2  # rad per px; integer search: what leaves the frame dominates longer waves


@dataclass(frozen=True)
class AscentSettings:
    """How far the likelihood is maximised."""

    max_alternations: int = 3  # of shifts and powers
    converged_shift: float = 0.05  # px; a smaller step ends the alternation of shifts and powers
    max_lbfgs_steps: int = 20  # L-BFGS steps of the shifts at fixed powers
    gradient_tolerance: float = 1.0  # nats per px; a smaller gradient ends L-BFGS
    em_iterations: int = 6  # expectation-maximisation steps of the powers at fixed shifts


WAVES = WaveSelection()
ASCENT = AscentSettings()


class Likelihood(Protocol):
    """Likelihood of the motions of K frames, of P parameters each, with powers to be estimated."""

    def negative_log_likelihood(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Value in nats, up to a constant, and gradient `(K P,)` at parameters `(K P,)` in px."""

    def update_powers(self, parameters: np.ndarray) -> None:
        """Estimate the powers at parameters `(K, P)` in px."""


def maximise(likelihood: Likelihood, parameters: np.ndarray) -> np.ndarray:
    """Maximise a likelihood by L-BFGS in turn with estimates of the powers.

    Args:
        likelihood: its state is changed.
        parameters: `(K, P)`, initial values, px.

    Returns:
        The parameters `(K, P)` at the local maximum, px.
    """
    options = {"maxiter": ASCENT.max_lbfgs_steps, "gtol": ASCENT.gradient_tolerance}
    objective = likelihood.negative_log_likelihood
    for _ in range(ASCENT.max_alternations):
        result = minimize(objective, parameters.ravel(), jac=True, method="L-BFGS-B", options=options)
        previous, parameters = parameters, result.x.reshape(parameters.shape)
        if np.abs(parameters - previous).max() < ASCENT.converged_shift:
            break
        likelihood.update_powers(parameters)
    return parameters


def maximise_shift_likelihood(frames: Tensor, start: np.ndarray) -> np.ndarray:
    """Maximum-likelihood shifts of frames relative to the first, from initial values.

    Args:
        frames: `(N, h, w)`, variance-stabilised.
        start: `(N - 1, 2)`, initial shifts (x, y), px.

    Returns:
        Shifts `(N - 1, 2)` (x, y), px.
    """
    return maximise(ShiftLikelihood(frames), start)


class ShiftLikelihood:
    """Likelihood of the shifts of all frames but the first, of frames `(N, h, w)`.

    y `(r,)`, x `(c,)`: angular frequencies of the waves used, rad per px. frames: `(N, r, c)`, the spectra. scene,
    noise: `(r, c)`, powers. pattern: power.
    """

    def __init__(self, frames: Tensor) -> None:
        h, w = frames.shape[1:]
        taper = hann_window(h, w).double()
        frames = (frames - (frames * taper).sum((1, 2), keepdim=True) / taper.sum()) * taper
        y, x = (2 * np.pi * waves for waves in (np.fft.fftfreq(h), np.fft.rfftfreq(w)))
        rows, columns = (
            (WAVES.axis_exclusion * 2 * np.pi / side < np.abs(each)) & (np.abs(each) < WAVES.max_wavenumber)
            for side, each in ((h, y), (w, x))
        )
        self.y, self.x = y[rows], x[columns]
        self.size, self.band = (h, w), np.ix_(rows, columns)
        spectra = torch.fft.rfft2(frames).numpy() / float(taper.square().sum().sqrt())
        self.frames = spectra[:, rows][:, :, columns]
        self.real, self.imag = (np.ascontiguousarray(each) for each in (self.frames.real, self.frames.imag))
        self.wavenumber = np.hypot(self.y[:, None], self.x)
        self.ring = np.digitize(
            self.wavenumber, np.geomspace(2 * np.pi / max(h, w), WAVES.max_wavenumber, WAVES.n_rings)
        )
        self.ring_sizes = np.bincount(self.ring.ravel(), minlength=WAVES.n_rings + 1)
        self._set_initial_powers(self.wavenumber > WAVES.high_band * WAVES.max_wavenumber)

    def _set_initial_powers(self, high_band: np.ndarray) -> None:
        """Initial powers: at high frequencies the temporal variance is noise and the rest of the power is pattern."""
        n = len(self.frames)
        power = (np.abs(self.frames) ** 2).mean(0)
        temporal_variance = (np.abs(self.frames - self.frames.mean(0)) ** 2).sum(0) / (n - 1)
        self.noise_floor = 1e-9 * float(power.mean())  # frames may be identical
        noise = max(float(temporal_variance[high_band].mean()), self.noise_floor)
        mean_over_median = 1 / np.log(2)  # of an exponential distribution, which is that of a wave's power
        pattern = max(mean_over_median * float(np.median(power[high_band])) - noise, 0.1 * noise)
        total = np.bincount(self.ring.ravel(), power.ravel(), WAVES.n_rings + 1)
        ring_mean = (total / np.maximum(self.ring_sizes, 1))[self.ring]
        self.scene = np.maximum(ring_mean - pattern - noise, 0.02 * pattern)
        self.pattern, self.noise = pattern, np.full(power.shape, noise)

    def negative_log_likelihood(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Value in nats, up to a constant, and gradient at shifts `(2 (N - 1),)` in px."""
        from deepir.kernels.shift_likelihood import negative_log_likelihood

        rows = len(self.y)
        values, gradient = np.empty(rows), np.empty((rows, len(self.real), 2))
        negative_log_likelihood(0, rows, *self._kernel_arguments(shifts.reshape(-1, 2)), values, gradient)
        return float(values.sum()), gradient.sum(0)[1:].ravel()

    def update_powers(self, shifts: np.ndarray) -> None:
        """Estimate the powers at shifts `(N - 1, 2)` in px by a few steps of expectation-maximisation."""
        from deepir.kernels.shift_likelihood import expected_powers

        n, rows = len(self.real), len(self.y)
        expected, pattern_powers = np.empty((rows, WAVES.n_rings + 1, 2)), np.empty(rows)
        for _ in range(ASCENT.em_iterations):
            expected_powers(0, rows, *self._kernel_arguments(shifts), self.ring, expected, pattern_powers)
            scene, noise = (expected.sum(0) / np.maximum(self.ring_sizes, 1)[:, None]).T
            self.scene, self.noise = scene[self.ring], np.maximum(noise / n, self.noise_floor)[self.ring]
            self.pattern = float(pattern_powers.sum()) / self.ring.size

    def _kernel_arguments(self, shifts: np.ndarray) -> tuple[Any, ...]:
        """Arguments of the compiled loops at shifts `(N - 1, 2)`; one call for all rows, too few for threads."""
        all_shifts = np.vstack((np.zeros((1, 2)), shifts))
        return self.real, self.imag, all_shifts, self.y, self.x, self.scene, self.pattern, self.noise


def integer_shifts(frames: Tensor) -> np.ndarray:
    """Most likely integer shifts of frames relative to the first, by coordinate descent over the frames.

    Each frame is compared with the placed ones at all shifts d at once. The first harmonic, in the phase `k d`, of the
    pairwise log-likelihood of each wave is summed over waves by a Fourier transform: a correlation in which scene,
    pattern and noise have their weights. Powers keep their initial values. At lag zero the pattern matches itself
    whatever its weight: that lag is excluded.

    Args:
        frames: `(N, h, w)`, variance-stabilised.

    Returns:
        Shifts `(N - 1, 2)` (x, y), px, whole numbers.
    """
    likelihood = ShiftLikelihood(frames)
    h, w = likelihood.size
    shifts, is_placed = np.zeros((len(frames), 2), int), np.arange(len(frames)) == 0
    for _ in range(MAX_SWEEPS):
        previous = shifts.copy()
        for k in range(1, len(frames)):
            other_frames = is_placed & (np.arange(len(frames)) != k)
            nats = np.fft.irfft2(first_harmonic(likelihood, k, other_frames, shifts), s=(h, w))
            nats[shifts[other_frames, 1], shifts[other_frames, 0]] = np.inf
            y, x = np.unravel_index(nats.argmin(), nats.shape)
            shifts[k] = (x + w // 2) % w - w // 2, (y + h // 2) % h - h // 2
            is_placed[k] = True
        if (shifts == previous).all():
            break
    return shifts[1:].astype(float)


def first_harmonic(
    likelihood: ShiftLikelihood, k: int, other_frames: np.ndarray, all_shifts: np.ndarray
) -> np.ndarray:
    """First harmonic, in the phase of each wave, of the pairwise negative log-likelihood of frame k and other frames.

    The covariance of two frames has the determinant `p - q cos(k d)`. Its logarithm and its inverse are series in
    powers of `ratio`.

    Args:
        likelihood: spectra and powers.
        k: frame number.
        other_frames: `(N,)` bool, the frames that it is compared with.
        all_shifts: `(N, 2)` (x, y), px; those of the other frames are used.

    Returns:
        `(h, w / 2 + 1)` complex, summed over the other frames; zero for waves that are not used.
    """
    scene, pattern, noise = likelihood.scene, likelihood.pattern, likelihood.noise
    cross = 2 * scene * pattern
    rest = noise * (noise + 2 * (scene + pattern))
    root = np.sqrt(rest * (rest + 2 * cross))
    ratio = cross / (rest + cross + root)
    shifts, frame = all_shifts[other_frames], likelihood.frames[k]
    phase_y, phase_x = np.exp(-1j * shifts[:, 1:] * likelihood.y), np.exp(-1j * shifts[:, :1] * likelihood.x)
    phase = phase_y[:, :, None] * phase_x[:, None]
    others = likelihood.frames[other_frames]
    ahead, behind = (others.conj() * phase).sum(0) * frame, (others * phase).sum(0) * frame.conj()
    power = (phase * (np.abs(others) ** 2 + np.abs(frame) ** 2)).sum(0)
    explained = (pattern + scene * ratio) * ratio * ahead + (pattern * ratio + scene) * behind
    values = ((scene + pattern + noise) * ratio * power - explained) / root - ratio * phase.sum(0)
    harmonic = np.zeros((likelihood.size[0], likelihood.size[1] // 2 + 1), complex)
    harmonic[likelihood.band] = np.where(likelihood.wavenumber < WAVES.min_wavenumber, 0, values)
    return harmonic
