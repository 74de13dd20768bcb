"""Parts of the frame, each of which only shifts: what they gain from motions, and the turns that are likeliest to all.

A whole frame's likelihood is of shifts. A part that is small enough shifts, too, where the frame turns: by what the
turn makes of its middle. So the sum over parts is a likelihood of turns, rough, for long waves do not fit into a part,
but not taken in by the pattern, under which residuals of plain scenes turn a camera that does not, and the other way.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from deepir.operators.motion_models import nearest_angle, rotation, transform_points
from deepir.registration.shift_likelihood import Spectra, likeliest

FOUR = (0, 2), (1, 3)  # parts of a frame along each axis: from and to so many thirds,
NINE = (0, 4), (3, 7), (6, 10)  # or tenths

Parts = tuple[tuple[int, int], ...]


def all_but_one(gained: list[float]) -> float:
    """The sum of all but the greatest."""
    return sum(gained) - max(gained)


def gains(frames: Tensor, before: Tensor, after: Tensor, parts: Parts) -> list[float]:
    """In nats, what each part of frames gains from motions `(N, 3, 3)` to others.

    A part only shifts, and its powers are those that are found at either.
    """
    found = []
    for spectra, centre in pieces(frames, parts):
        at, gain = torch.tensor([*centre, 1.0], dtype=torch.float64)[:, None], 0.0
        old, new = (
            (transform_points(motion[1:], at) - at[:2])[:, :, 0].numpy() for motion in (before, after)
        )
        for shifts in (new, old):
            spectra.update(shifts)
            gain += spectra.nats(old.ravel())[0] - spectra.nats(new.ravel())[0]
        found.append(gain)
    return found


def pieces(frames: Tensor, parts: Parts) -> Iterator[tuple[Spectra, np.ndarray]]:
    """The parts of frames `(N, h, w)`, and their middles (x, y), from the frame's."""
    h, w = frames.shape[1:]
    rows, columns = (
        [slice(a * side // parts[-1][1], b * side // parts[-1][1]) for a, b in parts] for side in (h, w)
    )
    for y, x in itertools.product(rows, columns):
        yield Spectra(frames[:, y, x]), np.array([x.start + x.stop - w, y.start + y.stop - h]) / 2


def likeliest_turns(frames: Tensor, start: Tensor) -> Tensor:
    """Rigid motions `(N, 3, 3)` of frames `(N, h, w)`, relative to the first, from a start `(N, 3, 3)`."""
    turns = _Turns(frames)
    angles = turns.reach * nearest_angle(start[1:])
    place = likeliest(turns, torch.cat((start[1:, :2, 2], angles[:, None]), 1).numpy())
    motion = start.clone()
    motion[1:] = rotation(torch.from_numpy(place[:, 2] / turns.reach))
    motion[1:, :2, 2] = torch.from_numpy(place[:, :2])
    return motion


class _Turns:
    """The parts' likelihood of x, y and angle, in px at the corners, of all frames but the first, `(N - 1, 3)`."""

    def __init__(self, frames: Tensor) -> None:
        self.reach = float(np.hypot(*frames.shape[1:])) / 2
        self.pieces = list(pieces(frames, NINE))

    def nats(self, place: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood, less what does not depend on the place; and its gradient."""
        total, slope = 0.0, np.zeros((place.size // 3, 3))
        for spectra, centre in self.pieces:
            shifts, by_angle = self._shifts(place.reshape(-1, 3), centre)
            nats, slopes = spectra.nats(shifts.ravel())
            slopes = slopes.reshape(-1, 2)
            total += nats
            slope[:, :2] += slopes
            slope[:, 2] += (slopes * by_angle).sum(1)
        return total, slope.ravel()

    def update(self, place: np.ndarray) -> None:
        """The powers that are likeliest there, of each part."""
        for spectra, centre in self.pieces:
            spectra.update(self._shifts(place, centre)[0])

    def _shifts(self, place: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far a part's middle moves, `(N - 1, 2)`, and how that changes with the angle."""
        cosine, sine = (each(place[:, 2:] / self.reach) for each in (np.cos, np.sin))
        across = np.array([-centre[1], centre[0]])
        moved = place[:, :2] + (cosine - 1) * centre + sine * across
        return moved, (cosine * across - sine * centre) / self.reach
