"""Shifts of all frames at once, by their likelihood: scene and pattern, Gaussian of unknown spectra, integrated out.

A wave k of frame j is `F_j = exp(i k d_j) X + P + noise`, of a scene X with a power that is that of all waves as long,
and a pattern P, whose power is one number but along rows and columns. Where a plain scene hides under its pattern, this
finds the frames' places where correlations and residuals are ruled by the pattern. (Expectation-maximisation for the
powers: Dempster, Laird, Rubin 1977.)
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.registration.align import Aligned, standing
from deepir.registration.group import FAILED, agreement
from deepir.registration.motion import identity, relative
from deepir.registration.pyramid import Level, average
from deepir.registration.search import window

SIZE = 320  # px: of larger frames, means over blocks are looked at
HIGHEST = 1.2  # radians a px: of shorter waves there is next to no scene
RINGS = 14  # of waves as long
LINE = 2.5  # waves along a line that make up those of lines, for the window's sake
CLEARLY = 0.85  # agreement from which a frame is used that was not
ALIKE = 0.3  # px that likelihood and residuals may be apart
SETTLED = 0.05  # px of the level: a smaller step ends the rounds
#: Px apart from where the quarters of the frame are asked which of two places they like better; and from where three of
#: the four will do for five frames and more, as they do for fewer, whose residuals say little.
APART, FAR_APART = 0.5, 1.5
QUARTERED = 64  # px: of smaller frames a quarter says too little
#: Px at the frame's edge up to which a motion may be a shift that was taken for a turn, at first and in the end.
TURNED, STILL_TURNED = 6.0, 2.0
ROUNDS, STEPS, PASSES = 3, 20, 6  # of powers after shifts; of the shifts at most; of the powers


def settle(flat: Tensor, level: Level, used: Tensor, found: Aligned) -> tuple[Tensor, Aligned]:
    """The frames `(N,)` that are used and their motions, moved to where they are likeliest if they fit better there.

    All frames are tried, then those that were used: for frames `(N, H, W)`, three or more, that only shift.
    """
    for some in (torch.ones_like(used), used):
        if some.sum() < 3 or not (_only_shifts(found.motion, level, TURNED) and flat[some].any()):
            return used, found
        start = identity(len(used))
        start[used, :2, 2] = found.motion[:, :2, 2]
        motion = start[some]
        motion[:, :2, 2] = likeliest_shifts(flat[some], motion[:, :2, 2])
        if used.all() and (motion - start)[:, :2, 2].abs().max() < ALIKE:
            return used, found  # residuals are finer
        mine, first = level.of(some), int(used[some].nonzero()[0])
        near = 4 * (motion - motion[first])[:, :2, 2].abs() <= torch.tensor(flat.shape[:0:-1])
        agree = torch.zeros(len(used), dtype=torch.float64)
        agree[some] = agreement(mine, standing(mine, motion)[0], motion) * near.all(1)
        more = torch.where(used, agree >= FAILED, agree >= CLEARLY)
        chosen = motion[more[some]]
        if not (used & ~more).any():
            moved = Aligned(relative(chosen), *standing(level.of(more), chosen))
            if bool((more & ~used).any()) or moved.misfit < standing(level.of(used), found.motion)[1]:
                return more, moved
        if used.all():
            break
    return used, found


def likelier(flat: Tensor, level: Level, motion: Tensor) -> Tensor:
    """Motions `(N, 3, 3)` of all flat frames `(N, H, W)`, moved to where they are likeliest if the frame agrees.

    Residuals are fine, but of few frames they are small at wrong places, too: a pattern that has all the freedom takes
    them up. The likelihood knows that, but not that something may walk through one part of the frame.
    """
    if len(motion) < 3 or min(flat.shape[1:]) < QUARTERED or not flat.any():
        return motion
    if not _only_shifts(motion, level, STILL_TURNED):
        return motion
    before = motion[:, :2, 2] - motion[0, :2, 2]
    after = likeliest_shifts(flat, before)
    apart = float((after - before).abs().max())
    if apart < APART:
        return motion
    few = len(motion) < 5 or apart > FAR_APART
    if sum(gain > 0 for gain in _gains(flat, before, after)) < (3 if few else 4):
        return motion
    motion = motion.clone()
    motion[:, :2, 2] = after + motion[0, :2, 2]
    return motion


def _gains(flat: Tensor, before: Tensor, after: Tensor) -> list[float]:
    """In nats, what each quarter of the frame gains from shifts `(N, 2)` to others, its powers as found at either."""
    factor = _shrunk(flat)
    frames = average(flat, factor).double()
    old, new = (each.double().numpy() / factor for each in (before, after))
    found = []
    for half in frames.tensor_split(2, dim=1):
        for quarter in half.tensor_split(2, dim=2):
            spectra, gain = _Spectra(quarter), 0.0
            for shifts in (old, new):
                spectra.update(shifts)
                gain += spectra.nats(old[1:].ravel())[0] - spectra.nats(new[1:].ravel())[0]
            found.append(gain)
    return found


def _shrunk(flat: Tensor) -> int:
    """Over how many px along an axis means are taken."""
    return max(1, -(-max(flat.shape[1:]) // SIZE))


def _only_shifts(motion: Tensor, level: Level, turned: float) -> bool:
    """Whether nothing turns or stretches by more than so many px at the frame's edge."""
    return bool((motion[:, :2, :2] - torch.eye(2)).abs().amax() * max(level.shape) / 2 < turned)


def likeliest_shifts(flat: Tensor, start: Tensor) -> Tensor:
    """Shifts `(N, 2)` (x, y) in px of flat frames `(N, H, W)`, relative to the first, from a start `(N, 2)`."""
    factor = _shrunk(flat)
    spectra = _Spectra(average(flat, factor).double())
    shifts = (start - start[0]).double().numpy() / factor
    for _ in range(ROUNDS):
        found = minimize(
            spectra.nats, shifts[1:].ravel(), jac=True, method="L-BFGS-B", options={"maxiter": STEPS}
        )
        moved = np.abs(found.x - shifts[1:].ravel()).max()
        shifts[1:] = found.x.reshape(-1, 2)
        if moved < SETTLED:
            break
        spectra.update(shifts)
    return torch.from_numpy(shifts * factor)


class _Spectra:
    """The frames' long waves, and the powers of scene (K), pattern (K) and noise; first guesses from their means."""

    def __init__(self, frames: Tensor) -> None:
        h, w = frames.shape[1:]
        apart = window(h, w).double()
        frames = (frames - (frames * apart).sum((1, 2), keepdim=True) / apart.sum()) * apart
        y, x = 2 * np.pi * np.fft.fftfreq(h)[:, None], 2 * np.pi * np.fft.rfftfreq(w)[None]
        length = np.hypot(y, x)
        some = (length > 0) & (length < HIGHEST)
        self.wave = np.stack([np.broadcast_to(each, length.shape)[some] for each in (x, y)])  # (2, K)
        self.frames = torch.fft.rfft2(frames).numpy()[:, some] / float(apart.square().sum().sqrt())
        edges = np.geomspace(2 * np.pi / max(h, w), HIGHEST, RINGS)
        self.ring = np.digitize(length[some], edges)
        across = np.abs(self.wave) < LINE * 2 * np.pi / np.array([[w], [h]])
        self.line = np.where(across[1], 1, np.where(across[0], 2, 0))  # of columns 1, of rows 2
        self._guess(length[some] > 0.8 * HIGHEST)

    def _guess(self, short: np.ndarray) -> None:
        """Of the shortest waves, what differs from frame to frame is noise, and what does not is pattern."""
        n, rest = len(self.frames), self.line == 0
        power = (np.abs(self.frames) ** 2).mean(0)
        differ = (np.abs(self.frames - self.frames.mean(0)) ** 2).sum(0) / (n - 1)
        self.least = 1e-9 * float(power.mean())  # frames may be identical
        self.noise = max(float(differ[short].mean()), self.least)
        middle = 1 / np.log(2)  # a wave's power has an exponential distribution: its mean from its median
        white = max(middle * float(np.median(power[short & rest])) - self.noise, 0.1 * self.noise)
        level = _means(np.where(rest, power, np.nan), self.ring)
        self.scene = np.maximum(np.nan_to_num(level) - white - self.noise, 0.02 * white)
        lines = _means(power - self.scene, self.line) - self.noise
        self.pattern = np.where(rest, white, np.maximum(lines, white))

    def nats(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood of shifts `(2 (N - 1))`, less what does not depend on them; and its gradient."""
        turn, total, along, both, det, a, b = self._normal(shifts.reshape(-1, 2))
        moved = turn.conj() * self.frames
        number = b * np.abs(along) ** 2 + a * np.abs(total) ** 2 - 2 * (along.conj() * both * total).real
        share = number / det
        d_number = 2 * b * (along.conj() * -1j * moved).real
        d_number -= 2 * (((-1j * moved).conj() * both + along.conj() * -1j * turn.conj()) * total).real
        d_det = -2 * (both.conj() * -1j * turn.conj()).real
        slope = ((share * d_det - d_number) / self.noise + d_det) / det
        return float((np.log(det) - share / self.noise).sum()), (slope[1:] @ self.wave.T).ravel()

    def update(self, shifts: np.ndarray) -> None:
        """The powers that are likeliest at these shifts, nearly."""
        n = len(self.frames)
        for _ in range(PASSES):
            turn, total, along, both, det, a, b = self._normal(shifts[1:])
            scene, pattern = (b * along - both * total) / det, (a * total - both.conj() * along) / det
            unsure = self.noise / det
            left = (np.abs(self.frames - turn * scene - pattern) ** 2).sum(0)
            left += unsure * (n * (a + b) - 2 * np.abs(both) ** 2)
            self.scene = _means(np.abs(scene) ** 2 + unsure * b, self.ring)
            self.pattern = _means(np.abs(pattern) ** 2 + unsure * a, self.line)
            self.noise = max(float(left.mean()) / n, self.least)

    def _normal(self, shifts: np.ndarray) -> tuple[np.ndarray, ...]:
        """`exp(i k d)` (N, K), the frames' sums, as they are and moved back, and the normal equations."""
        n = len(self.frames)
        turn = np.exp(1j * (np.vstack((np.zeros((1, 2)), shifts)) @ self.wave))
        a, b = n + self.noise / self.scene, n + self.noise / self.pattern
        both = turn.conj().sum(0)
        along = (turn.conj() * self.frames).sum(0)
        return turn, self.frames.sum(0), along, both, a * b - np.abs(both) ** 2, a, b


def _means(values: np.ndarray, kind: np.ndarray) -> np.ndarray:
    """For each wave the mean over all of its kind, of those that are numbers."""
    known = np.isfinite(values)
    total = np.bincount(kind, np.where(known, values, 0.0), RINGS + 1)
    return (total / np.maximum(np.bincount(kind, known, RINGS + 1), 1))[kind]
