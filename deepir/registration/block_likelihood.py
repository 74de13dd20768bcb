"""Parts of the frame, each of which only shifts: what they gain from motions, and the turns that are likeliest to all.

A whole frame's likelihood is of shifts. A part that is small enough shifts, too, where the frame turns: by what the
turn makes of its middle. So the sum over parts is a likelihood of turns, rough, for long waves do not fit into a part,
but not taken in by the pattern, under which residuals of plain scenes turn a camera that does not, and the other way.


Between the motion of least residuals and the likeliest shifts: the parts of the frame decide."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from deepir.operators.motion_models import carried, identity, nearest_angle, relative, rotation
from deepir.registration.preprocess import variance_stabilise
from deepir.registration.pyramid import block_mean
from deepir.registration.shift_likelihood import (
    ShiftLikelihood,
    integer_shifts,
    maximise,
    maximise_shift_likelihood,
)

GRID_2X2 = (0, 2), (1, 3)  # parts of a frame along each axis: from and to so many thirds,
GRID_3X3 = (0, 4), (3, 7), (6, 10)  # or tenths

Grid = tuple[tuple[int, int], ...]

LIKELIHOOD_SIDE = 320  # px; larger frames are reduced to block means of this longer side
MIN_REDUCED_SIDE = 20  # px; shorter side below which frames are not reduced: a ninth of less holds no waves
MIN_SIDE = 16  # px; blocks of smaller frames say too little
MAX_SHIFT_RANGE = 0.5  # of the frame's side; the likelihood is periodic, so that larger shifts alias
MAX_LINEAR_DISPLACEMENT = (
    6.0  # px at the frame's edge; a motion whose linear part moves it less may be a shift
)
MAX_FRAMES_OF_INTEGER_SEARCH = 20  # its time grows with the square of the frames
DISTINCT_DISTANCE = 2.0  # px; the likelihood climbs from closer starts to the same maximum
NEGLIGIBLE_DISTANCE = 0.2  # px at the frame's corners; closer motions are the same
MODELS_WITH_STRETCH = ("affine", "homography")  # models whose linear part is kept while shifts are replaced


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


def select_by_blocks(frames: Tensor, weight: Tensor, motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)` of frames `(N, H, W)`, or the likeliest shifts if the parts of the frame like these better.

    Residuals are fine, but of few frames they are small at wrong places, too: a pattern that has all the freedom takes
    them up. The likelihood knows that, but not that something may walk through one part of the frame: so what counts is
    the gain of all parts but the one that gains most. weight: `(H, W)`, zero where a pixel is bad.
    """
    if (
        len(frames) < 3
        or min(weight.shape) < MIN_SIDE
        or relative_shift_range(motion, weight) > MAX_SHIFT_RANGE
    ):
        return motion
    reduced, factor = likelihood_frames(frames, weight)
    current = relative(motion)
    rotated, current = has_linear_part(current, weight), change_pixel_size(current, factor)
    best = current
    linear = best.clone() if model in MODELS_WITH_STRETCH else identity(len(motion))
    for initial in initial_shifts(reduced, current[1:, :2, 2].numpy(), rotated):
        after = linear.clone()
        after[1:, :2, 2] = torch.from_numpy(maximise_shift_likelihood(reduced, initial))
        if factor * corner_distance(best, after, reduced) >= NEGLIGIBLE_DISTANCE and accepted_by_blocks(
            reduced, best, after
        ):
            best = after
    return motion if best is current else change_pixel_size(best, 1 / factor)


def likelihood_frames(frames: Tensor, weight: Tensor, size: int = LIKELIHOOD_SIDE) -> tuple[Tensor, int]:
    """Frames `(N, h, w)` as the likelihood looks at frames `(N, H, W)`, and how much smaller they are."""
    factor = max(1, min(-(-max(weight.shape) // size), min(weight.shape) // MIN_REDUCED_SIDE))
    return variance_stabilise(block_mean(frames.float(), factor), block_mean(weight[None], factor)[0]), factor


def change_pixel_size(motion: Tensor, factor: float) -> Tensor:
    """Motions `(N, 3, 3)` in px that are `factor` times as large."""
    out = motion.clone()
    out[:, :2, 2] /= factor
    out[:, 2, :2] *= factor
    return out


def has_linear_part(motion: Tensor, weight: Tensor) -> bool:
    """Whether relative motions `(N, 3, 3)` of frames that are as large as `weight` are no shifts."""
    return (
        float((motion[:, :2, :2] - torch.eye(2)).abs().amax()) * max(weight.shape) / 2
        > MAX_LINEAR_DISPLACEMENT
    )


def relative_shift_range(motion: Tensor, weight: Tensor) -> float:
    """How far apart motions `(N, 3, 3)` put frames that are as large as `weight`, in shares of their sides."""
    shifts = motion[:, :2, 2] / torch.tensor(weight.shape[::-1])
    return float((shifts.amax(0) - shifts.amin(0)).max())


def initial_shifts(frames: Tensor, residual_shifts: np.ndarray, rotated: bool) -> list[np.ndarray]:
    """Shifts `(N - 1, 2)` from which the likelihood climbs: where residuals are least, and elsewhere.

    A turn is no shift; but where the search was taken in by the pattern, it found a turn, as often as not.
    """
    candidates = [] if rotated else [residual_shifts.copy()]
    if len(frames) > MAX_FRAMES_OF_INTEGER_SEARCH:
        return candidates
    whole_shifts = integer_shifts(frames)
    return (
        [*candidates, whole_shifts]
        if np.abs(whole_shifts - residual_shifts).max() > DISTINCT_DISTANCE
        else candidates
    )


def corner_distance(before: Tensor, after: Tensor, frames: Tensor) -> float:
    """How far motions `(N, 3, 3)` are apart at most, in px, at the corners of frames."""
    h, w = frames.shape[1:]
    corners = torch.tensor([[-w, w, w, -w], [-h, -h, h, h], [2, 2, 2, 2]], dtype=torch.float64) / 2
    return float((carried(after, corners) - carried(before, corners)).norm(dim=1).max())


def accepted_by_blocks(frames: Tensor, before: Tensor, after: Tensor) -> bool:
    """Whether all parts of frames but the one that gains most gain from motions `(N, 3, 3)` to others, in sum."""
    return leave_best_out_sum(block_log_ratios(frames, before, after, GRID_2X2)) >= 0
