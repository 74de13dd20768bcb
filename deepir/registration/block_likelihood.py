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

from deepir.operators.motion_models import carried, nearest_angle, rotation
from deepir.registration.shift_likelihood import ShiftLikelihood, maximise

GRID_2X2 = (0, 2), (1, 3)  # parts of a frame along each axis: from and to so many thirds,
GRID_3X3 = (0, 4), (3, 7), (6, 10)  # or tenths

Grid = tuple[tuple[int, int], ...]


def leave_best_out_sum(ratios: list[float]) -> float:
    """The sum of all but the greatest."""
    return sum(ratios) - max(ratios)


def block_log_ratios(frames: Tensor, before: Tensor, after: Tensor, grid: Grid) -> list[float]:
    """In nats, what each part of frames gains from motions `(N, 3, 3)` to others.

    A part only shifts, and its powers are those that are found at either.
    """
    ratios = []
    for likelihood, centre in blocks(frames, grid):
        centre_point, ratio = torch.tensor([*centre, 1.0], dtype=torch.float64)[:, None], 0.0
        shifts_before, shifts_after = (
            (carried(motion[1:], centre_point) - centre_point[:2])[:, :, 0].numpy()
            for motion in (before, after)
        )
        for shifts in (shifts_after, shifts_before):
            likelihood.update_powers(shifts)
            ratio += (
                likelihood.negative_log_likelihood(shifts_before.ravel())[0]
                - likelihood.negative_log_likelihood(shifts_after.ravel())[0]
            )
        ratios.append(ratio)
    return ratios


def blocks(frames: Tensor, grid: Grid) -> Iterator[tuple[ShiftLikelihood, np.ndarray]]:
    """The parts of frames `(N, h, w)`, and their middles (x, y), from the frame's."""
    h, w = frames.shape[1:]
    rows, columns = (
        [slice(a * side // grid[-1][1], b * side // grid[-1][1]) for a, b in grid] for side in (h, w)
    )
    for y, x in itertools.product(rows, columns):
        yield ShiftLikelihood(frames[:, y, x]), np.array([x.start + x.stop - w, y.start + y.stop - h]) / 2


def maximise_rotation_likelihood(frames: Tensor, start: Tensor) -> Tensor:
    """Rigid motions `(N, 3, 3)` of frames `(N, h, w)`, relative to the first, from a start `(N, 3, 3)`."""
    likelihood = RotationLikelihood(frames)
    angles = likelihood.half_diagonal * nearest_angle(start[1:])
    parameters = maximise(likelihood, torch.cat((start[1:, :2, 2], angles[:, None]), 1).numpy())
    motion = start.clone()
    motion[1:] = rotation(torch.from_numpy(parameters[:, 2] / likelihood.half_diagonal))
    motion[1:, :2, 2] = torch.from_numpy(parameters[:, :2])
    return motion


class RotationLikelihood:
    """The parts' likelihood of x, y and angle, in px at the corners, of all frames but the first, `(N - 1, 3)`."""

    def __init__(self, frames: Tensor) -> None:
        self.half_diagonal = float(np.hypot(*frames.shape[1:])) / 2
        self.blocks = list(blocks(frames, GRID_3X3))

    def negative_log_likelihood(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Minus the log-likelihood, less what does not depend on the place; and its gradient."""
        total, gradient = 0.0, np.zeros((parameters.size // 3, 3))
        for likelihood, centre in self.blocks:
            shifts, angle_derivative = self._block_shifts(parameters.reshape(-1, 3), centre)
            value, block_gradient = likelihood.negative_log_likelihood(shifts.ravel())
            block_gradient = block_gradient.reshape(-1, 2)
            total += value
            gradient[:, :2] += block_gradient
            gradient[:, 2] += (block_gradient * angle_derivative).sum(1)
        return total, gradient.ravel()

    def update_powers(self, parameters: np.ndarray) -> None:
        """The powers that are likeliest there, of each part."""
        for likelihood, centre in self.blocks:
            likelihood.update_powers(self._block_shifts(parameters, centre)[0])

    def _block_shifts(self, parameters: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far a part's middle moves, `(N - 1, 2)`, and how that changes with the angle."""
        cosine, sine = (each(parameters[:, 2:] / self.half_diagonal) for each in (np.cos, np.sin))
        tangent = np.array([-centre[1], centre[0]])
        shifts = parameters[:, :2] + (cosine - 1) * centre + sine * tangent
        return shifts, (cosine * tangent - sine * centre) / self.half_diagonal
