"""Shifts of all frames at once, by their likelihood: scene and pattern, Gaussian of unknown spectra, integrated out.

A wave k of frame j is `F_j = exp(i k d_j) X + P + noise`, of a scene X with a power that is that of all waves as long,
and a pattern P, whose power is one number. Noise, too, has a power for each length: what leaves the frame or walks
through it is in there. Waves along rows and columns are not asked: the pattern's lines are in them, and a scene's slope
or horizon, which then passes for lines. Where a plain scene hides under its pattern, this finds the frames' places
where correlations and residuals are ruled by the pattern. (Expectation-maximisation for the powers: Dempster, Laird,
Rubin 1977.)
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.registration.cross_correlation import window

HIGHEST = 2.5  # radians a px: of shorter waves there is next to no scene
RINGS = 14  # of waves as long
LINE = 2.5  # waves along rows or columns up to which lines are seen, for the window's sake
SETTLED = 0.05  # px: a smaller step ends the rounds
ROUNDS, STEPS, PASSES = 3, 20, 6  # of powers after shifts; of the shifts at most; of the powers
STEEP = 1.0  # nats a px: less ends the steps


class Likelihood(Protocol):
    """Of places `(K, P)`, under powers that are unknown, too."""

    def nats(self, place: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of places `(K P)`, less what does not depend on them; and its gradient."""

    def update(self, place: np.ndarray) -> None:
        """The powers that are likeliest at places `(K, P)`, nearly."""


def likeliest(likelihood: Likelihood, place: np.ndarray) -> np.ndarray:
    """The places `(K, P)` to which the likelihood climbs from a start `(K, P)`; all in px."""
    options = {"maxiter": STEPS, "gtol": STEEP}
    for _ in range(ROUNDS):
        found = minimize(likelihood.nats, place.ravel(), jac=True, method="L-BFGS-B", options=options)
        before, place = place, found.x.reshape(place.shape)
        if np.abs(place - before).max() < SETTLED:
            break
        likelihood.update(place)
    return place


def likeliest_shifts(frames: Tensor, start: np.ndarray) -> np.ndarray:
    """Shifts `(N - 1, 2)` (x, y) in px of frames `(N, h, w)`, relative to the first, from a start `(N - 1, 2)`."""
    return likeliest(Spectra(frames), start)


class Spectra:
    """The frames' long waves `(N, h, w)`, the powers `(h, w)` of scene and noise, and the pattern's."""

    def __init__(self, frames: Tensor) -> None:
        h, w = frames.shape[1:]
        apart = window(h, w).double()
        frames = (frames - (frames * apart).sum((1, 2), keepdim=True) / apart.sum()) * apart
        y, x = (2 * np.pi * waves for waves in (np.fft.fftfreq(h), np.fft.rfftfreq(w)))
        rows, columns = (
            (LINE * 2 * np.pi / side < np.abs(each)) & (np.abs(each) < HIGHEST)
            for side, each in ((h, y), (w, x))
        )
        self.y, self.x = y[rows], x[columns]
        self.size, self.known = (h, w), np.ix_(rows, columns)
        spectra = torch.fft.rfft2(frames).numpy() / float(apart.square().sum().sqrt())
        self.frames = spectra[:, rows][:, :, columns]
        self.real, self.imag = (np.ascontiguousarray(each) for each in (self.frames.real, self.frames.imag))
        self.length = np.hypot(self.y[:, None], self.x)
        self.ring = np.digitize(self.length, np.geomspace(2 * np.pi / max(h, w), HIGHEST, RINGS))
        self.sizes = np.bincount(self.ring.ravel(), minlength=RINGS + 1)
        self._guess(self.length > 0.8 * HIGHEST)

    def _guess(self, short: np.ndarray) -> None:
        """Of the shortest waves, what differs from frame to frame is noise, and what does not is pattern."""
        n = len(self.frames)
        power = (np.abs(self.frames) ** 2).mean(0)
        differ = (np.abs(self.frames - self.frames.mean(0)) ** 2).sum(0) / (n - 1)
        self.least = 1e-9 * float(power.mean())  # frames may be identical
        noise = max(float(differ[short].mean()), self.least)
        middle = 1 / np.log(2)  # a wave's power has an exponential distribution: its mean from its median
        white = max(middle * float(np.median(power[short])) - noise, 0.1 * noise)
        total = np.bincount(self.ring.ravel(), power.ravel(), RINGS + 1)
        self.scene = np.maximum((total / np.maximum(self.sizes, 1))[self.ring] - white - noise, 0.02 * white)
        self.pattern, self.noise = white, np.full(power.shape, noise)

    def nats(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of shifts `(2 (N - 1))`, less what does not depend on them; and its gradient."""
        from deepir.kernels.shift_likelihood import negative_log_likelihood

        rows = len(self.y)
        found, slope = np.empty(rows), np.empty((rows, len(self.real), 2))
        negative_log_likelihood(0, rows, *self._at(shifts.reshape(-1, 2)), found, slope)
        return float(found.sum()), slope.sum(0)[1:].ravel()

    def update(self, shifts: np.ndarray) -> None:
        """The powers that are likeliest at shifts `(N - 1, 2)`, nearly."""
        from deepir.kernels.shift_likelihood import expected_powers

        n, rows = len(self.real), len(self.y)
        expected, white = np.empty((rows, RINGS + 1, 2)), np.empty(rows)
        for _ in range(PASSES):
            expected_powers(0, rows, *self._at(shifts), self.ring, expected, white)
            scene, noise = (expected.sum(0) / np.maximum(self.sizes, 1)[:, None]).T
            self.scene, self.noise = scene[self.ring], np.maximum(noise / n, self.least)[self.ring]
            self.pattern = float(white.sum()) / self.ring.size

    def _at(self, shifts: np.ndarray) -> tuple[Any, ...]:
        """What the loops take, at shifts `(N - 1, 2)`: all rows at once, which are too few to share among threads."""
        moved = np.vstack((np.zeros((1, 2)), shifts))
        return self.real, self.imag, moved, self.y, self.x, self.scene, self.pattern, self.noise
