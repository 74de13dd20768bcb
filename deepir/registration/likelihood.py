"""Shifts of all frames at once, by their likelihood: scene and pattern, Gaussian of unknown spectra, integrated out.

A wave k of frame j is `F_j = exp(i k d_j) X + P + noise`, of a scene X with a power that is that of all waves as long,
and a pattern P, whose power is one number. Noise, too, has a power for each length: what leaves the frame or walks
through it is in there. Waves along rows and columns are not asked: the pattern's lines are in them, and a scene's slope
or horizon, which then passes for lines. Where a plain scene hides under its pattern, this finds the frames' places
where correlations and residuals are ruled by the pattern. (Expectation-maximisation for the powers: Dempster, Laird,
Rubin 1977.)
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.registration.search import window

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
        self.total = self.frames.sum(0)
        self.length = np.hypot(self.y[:, None], self.x)
        self.ring = np.digitize(self.length, np.geomspace(2 * np.pi / max(h, w), HIGHEST, RINGS))
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
        self.scene = np.maximum(_means(power, self.ring) - white - noise, 0.02 * white)
        self.pattern, self.noise = white, np.full(power.shape, noise)

    def nats(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of shifts `(2 (N - 1))`, less what does not depend on them; and its gradient."""
        turn, along, both, det, scene, pattern = self._scene_and_pattern(shifts.reshape(-1, 2))
        explained = (along.conj() * scene + self.total.conj() * pattern).real / self.noise
        pull = ((self.frames - pattern).conj() * (scene / self.noise) + both / det) * turn
        rows, columns = pull.imag.sum(2) @ self.y, pull.imag.sum(1) @ self.x
        slope = 2 * np.stack((columns, rows), 1)[1:].ravel()
        return float((np.log(det) - explained).sum()), slope

    def update(self, shifts: np.ndarray) -> None:
        """The powers that are likeliest at shifts `(N - 1, 2)`, nearly."""
        n = len(self.frames)
        for _ in range(PASSES):
            turn, _, both, det, scene, pattern = self._scene_and_pattern(shifts)
            a, b = n + self.noise / self.scene, n + self.noise / self.pattern
            unsure = self.noise / det
            left = (np.abs(self.frames - turn * scene - pattern) ** 2).sum(0)
            left += unsure * (n * (a + b) - 2 * np.abs(both) ** 2)
            self.scene = _means(np.abs(scene) ** 2 + unsure * b, self.ring)
            self.pattern = float((np.abs(pattern) ** 2 + unsure * a).mean())
            self.noise = np.maximum(_means(left, self.ring) / n, self.least)

    def _scene_and_pattern(self, shifts: np.ndarray) -> tuple[np.ndarray, ...]:
        """`exp(i k d)`, the frames' sum moved back, the normal equations' off-diagonal, determinant and solution."""
        n, (dx, dy) = len(self.frames), np.vstack((np.zeros((1, 2)), shifts)).T
        turn = np.exp(1j * dy[:, None] * self.y)[:, :, None] * np.exp(1j * dx[:, None] * self.x)[:, None]
        a, b = n + self.noise / self.scene, n + self.noise / self.pattern
        both, along = turn.conj().sum(0), (turn.conj() * self.frames).sum(0)
        det = a * b - np.abs(both) ** 2
        scene, pattern = (b * along - both * self.total) / det, (a * self.total - both.conj() * along) / det
        return turn, along, both, det, scene, pattern


def _means(values: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """For each wave the mean over all of its kind."""
    total = np.bincount(kind.ravel(), values.ravel(), RINGS + 1)
    return (total / np.maximum(np.bincount(kind.ravel(), minlength=RINGS + 1), 1))[kind]
