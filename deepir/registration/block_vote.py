"""Between the motion of least residuals and the likeliest shifts: the parts of the frame decide."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.operators.motion_models import carried, identity, relative
from deepir.registration.block_likelihood import GRID_2X2, block_log_ratios, leave_best_out_sum
from deepir.registration.integer_shifts import integer_shifts
from deepir.registration.pyramid import block_mean
from deepir.registration.shift_likelihood import maximise_shift_likelihood
from deepir.registration.variance_stabilise import variance_stabilise

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
