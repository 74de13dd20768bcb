"""Block-wise likelihood of motions: log-likelihood ratios that decide between motions, and a likelihood of rotations.

`ShiftLikelihood` holds for shifts only. In a small block of the frame other motions are shifts, too: those of its
centre. So blocks compare any two motions (`block_log_ratios`), and the sum over blocks is a likelihood of rotations
(`RotationLikelihood`). It is coarse, since long waves do not fit into a block, but the pattern does not bias it; least
residuals of weakly textured scenes may rotate frames that do not, and the reverse.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
import torch
from torch import Tensor

from deepir.operators.motion_models import identity, nearest_angle, relative, rotation, transform_points
from deepir.registration.preprocess import block_mean, variance_stabilise
from deepir.registration.shift_likelihood import ShiftLikelihood, integer_shifts, maximise

Grid = tuple[tuple[int, int], ...]

GRID_2X2: Grid = ((0, 2), (1, 3))  # overlapping blocks along an axis: first and last third of each
GRID_3X3: Grid = ((0, 4), (3, 7), (6, 10))  # overlapping blocks along an axis: first and last tenth of each
LIKELIHOOD_SIDE = 320  # px; larger frames are reduced to block means of this longer side
MIN_BLOCK_SIDE = 8  # px; smaller blocks hold no waves
MIN_REDUCED_SIDE = 20  # px; shorter side below which frames are not reduced: a ninth of less holds no waves
MAX_LINEAR_DISPLACEMENT = 6.0  # px at the frame's edge; motions whose linear part moves it less may be shifts
DISTINCT_DISTANCE = 2.0  # px; from closer starts the likelihood climbs to the same maximum
MODELS_WITH_STRETCH = ("affine", "homography")  # models whose linear part is kept while shifts are replaced

MAX_INTEGER_FRAMES = 20  # the time of the integer search grows with the square of their number


def accept_by_blocks(block_ratios: list[float], n_left_out: int = 1, min_nats: float = 0.0) -> bool:
    """Decide for a motion if the sum of its log-likelihood ratios over all but the best blocks exceeds `min_nats`.

    The ratios, nats of each block, are against the motion that it would replace. Those of the `n_left_out` best blocks
    do not count, since a moving object may cover them.
    """
    return sum(block_ratios) - sum(sorted(block_ratios)[-n_left_out:]) > min_nats


def block_log_ratios(frames: Tensor, before: Tensor, after: Tensor, grid: Grid) -> list[float]:
    """Log-likelihood ratios of two sets of motions, block by block.

    A block shifts as its centre does. Its powers are estimated at either motion in turn, and the two ratios are added.
    In nats, positive where the motions `after` are more likely. Motions `(N, 3, 3)` are relative to the first of the
    variance-stabilised frames `(N, h, w)`, in px of these; the grid holds the blocks along each axis.
    """
    ratios = []
    for likelihood, centre in blocks(frames, grid):
        point, ratio = torch.tensor([*centre, 1.0], dtype=torch.float64)[:, None], 0.0
        old, new = ((transform_points(motion[1:], point) - point[:2])[:, :, 0].numpy() for motion in (before, after))
        for shifts in (new, old):
            likelihood.update_powers(shifts)
            nats = [likelihood.negative_log_likelihood(each.ravel())[0] for each in (old, new)]
            ratio += nats[0] - nats[1]
        ratios.append(ratio)
    return ratios


def blocks(frames: Tensor, grid: Grid) -> Iterator[tuple[ShiftLikelihood, np.ndarray]]:
    """Likelihood of each block of frames `(N, h, w)` that holds waves, and its centre (x, y) in px from the frame's."""
    h, w = frames.shape[1:]
    rows, columns = ([slice(a * side // grid[-1][1], b * side // grid[-1][1]) for a, b in grid] for side in (h, w))
    for y, x in itertools.product(rows, columns):
        if min(y.stop - y.start, x.stop - x.start) < MIN_BLOCK_SIDE:
            continue
        yield ShiftLikelihood(frames[:, y, x]), np.array([x.start + x.stop - w, y.start + y.stop - h]) / 2


def maximise_rotation_likelihood(frames: Tensor, start: Tensor) -> Tensor:
    """Maximum-likelihood rigid motions `(N, 3, 3)` of variance-stabilised frames `(N, h, w)`, from initial motions.

    Both are relative to the first frame, in px of these frames.
    """
    likelihood = RotationLikelihood(frames)
    angles = likelihood.half_diagonal * nearest_angle(start[1:])
    parameters = maximise(likelihood, torch.cat((start[1:, :2, 2], angles[:, None]), 1).numpy())
    motion = start.clone()
    motion[1:] = rotation(torch.from_numpy(parameters[:, 2] / likelihood.half_diagonal))
    motion[1:, :2, 2] = torch.from_numpy(parameters[:, :2])
    return motion


class RotationLikelihood:
    """Likelihood of rigid motions of all frames but the first: sum over blocks that shift.

    Parameters are `(N - 1, 3)`: x, y and angle, the angle in px of displacement at the frame's corners.
    """

    def __init__(self, frames: Tensor) -> None:
        self.half_diagonal = float(np.hypot(*frames.shape[1:])) / 2
        self.blocks = list(blocks(frames, GRID_3X3))

    def negative_log_likelihood(self, parameters: np.ndarray) -> tuple[float, np.ndarray]:
        """Value in nats, up to a constant, and gradient at parameters `(3 (N - 1),)`."""
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
        """Estimate the powers of each block at parameters `(N - 1, 3)`."""
        for likelihood, centre in self.blocks:
            likelihood.update_powers(self._block_shifts(parameters, centre)[0])

    def _block_shifts(self, parameters: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shifts `(N - 1, 2)` of a block's centre at parameters `(N - 1, 3)`, and their derivative by the angle."""
        cosine, sine = (each(parameters[:, 2:] / self.half_diagonal) for each in (np.cos, np.sin))
        tangent = np.array([-centre[1], centre[0]])
        shifts = parameters[:, :2] + (cosine - 1) * centre + sine * tangent
        return shifts, (cosine * tangent - sine * centre) / self.half_diagonal


def select_by_blocks(frames: Tensor, weight: Tensor, motion: Tensor, model: str) -> Tensor:
    """Replace motions of least residuals by maximum-likelihood shifts where the blocks' likelihood accepts these.

    Residuals of few frames are small at wrong motions, too, since an unconstrained pattern absorbs them. The likelihood
    accounts for that, but not for an object that moves through one part of the frame: the best block does not count.

    Args:
        frames: `(N, H, W)`, not preprocessed.
        weight: `(H, W)`, zero where a pixel is bad.
        motion: `(N, 3, 3)`, px.
        model: motion model; the linear part of models with stretch is kept.

    Returns:
        Motions `(N, 3, 3)`; the object `motion` itself if no others are accepted.
    """
    shifts = motion[:, :2, 2] / torch.tensor(weight.shape[::-1])
    too_small = len(frames) < 3 or min(weight.shape) < 16  # px; blocks of smaller frames hold too few waves
    # Shifts over more than half a side alias, since the likelihood is periodic.
    if too_small or (shifts.amax(0) - shifts.amin(0)).max() > 0.5:
        return motion
    reduced, factor = likelihood_frames(frames, weight)
    residual = relative(motion)
    is_shift, residual = not has_linear_part(residual, weight), change_pixel_size(residual, factor)
    best = residual
    linear = best.clone() if model in MODELS_WITH_STRETCH else identity(len(motion))
    for start in initial_shifts(reduced, residual[1:, :2, 2].numpy(), is_shift):
        after = linear.clone()
        after[1:, :2, 2] = torch.from_numpy(maximise(ShiftLikelihood(reduced), start))
        if factor * corner_distance(best, after, reduced) < 0.2:  # px; the same motion
            continue
        if accept_by_blocks(block_log_ratios(reduced, best, after, GRID_2X2)):
            best = after
    return motion if best is residual else change_pixel_size(best, 1 / factor)


def initial_shifts(frames: Tensor, residual_shifts: np.ndarray, is_shift: bool) -> list[np.ndarray]:
    """Initial values for the likelihood of shifts: those of least residuals, and the most likely integer shifts.

    If the motions of least residuals are no shifts, they are no start. Rotations may be wrong: where the pattern
    misleads the search, it often finds a rotation. Shifts are `(N - 1, 2)`, px; the frames are variance-stabilised.
    """
    starts = [residual_shifts.copy()] if is_shift else []
    if len(frames) > MAX_INTEGER_FRAMES:
        return starts
    integer = integer_shifts(frames)
    return [*starts, integer] if np.abs(integer - residual_shifts).max() > DISTINCT_DISTANCE else starts


def likelihood_frames(frames: Tensor, weight: Tensor, side: int = LIKELIHOOD_SIDE) -> tuple[Tensor, int]:
    """Block means of frames, the variance of their pattern stabilised, and the factor by which they are smaller.

    Of frames `(N, H, W)`, not preprocessed, of weight `(H, W)`. Their longer side is reduced to `side` px, as long as
    the shorter one keeps `MIN_REDUCED_SIDE`.
    """
    factor = max(1, min(-(-max(weight.shape) // side), min(weight.shape) // MIN_REDUCED_SIDE))
    return variance_stabilise(block_mean(frames.float(), factor), block_mean(weight[None], factor)[0]), factor


def change_pixel_size(motion: Tensor, factor: float) -> Tensor:
    """Motions `(N, 3, 3)` in px, converted to px that are `factor` times as large."""
    converted = motion.clone()
    converted[:, :2, 2] /= factor
    converted[:, 2, :2] *= factor
    return converted


def has_linear_part(motion: Tensor, weight: Tensor) -> bool:
    """Whether relative motions `(N, 3, 3)` of frames of the weight's shape rotate or stretch noticeably."""
    deviation = float((motion[:, :2, :2] - torch.eye(2)).abs().amax())
    return deviation * max(weight.shape) / 2 > MAX_LINEAR_DISPLACEMENT


def corner_distance(before: Tensor, after: Tensor, frames: Tensor) -> float:
    """Largest distance, px, between two sets of motions `(N, 3, 3)` at the corners of frames `(N, h, w)`."""
    h, w = frames.shape[1:]
    corners = torch.tensor([[-w, w, w, -w], [-h, -h, h, h], [2, 2, 2, 2]], dtype=torch.float64) / 2
    return float((transform_points(after, corners) - transform_points(before, corners)).norm(dim=1).max())
