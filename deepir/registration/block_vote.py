"""Between the motion of least residuals and the likeliest shifts: the parts of the frame decide."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.operators.motion_models import identity, relative, transform_points
from deepir.registration.block_likelihood import FOUR, all_but_one, gains
from deepir.registration.integer_shifts import integer_shifts
from deepir.registration.pyramid import average
from deepir.registration.shift_likelihood import likeliest_shifts
from deepir.registration.variance_stabilise import variance_stabilise

SIZE = 320  # px: of larger frames, means over blocks are looked at
TURNED = 6.0  # px at the frame's edge up to which a motion may be a shift
MOST = 20  # frames up to which it is asked where else the likelihood may climb to: that takes their square in time
FAR = 2.0  # px: what is nearer to whole shifts is where a climb from there would end, too
APART = 0.2  # px at the frame's corners: what is closer is the same
STRETCHED = ("affine", "homography")  # models of which only the shift is changed
LEAST = 16  # px: of smaller frames a part says too little
SIDE = 20  # px: so wide is what is looked at of a frame that is long, for a ninth part of less has no waves
#: Of the frame: of places further apart the likelihood, for which what leaves a frame comes in again, knows nothing.
SHARED = 0.5


def likelier(frames: Tensor, weight: Tensor, motion: Tensor, model: str) -> Tensor:
    """Motions `(N, 3, 3)` of frames `(N, H, W)`, or the likeliest shifts if the parts of the frame like these better.

    Residuals are fine, but of few frames they are small at wrong places, too: a pattern that has all the freedom takes
    them up. The likelihood knows that, but not that something may walk through one part of the frame: so what counts is
    the gain of all parts but the one that gains most. weight: `(H, W)`, zero where a pixel is bad.
    """
    if len(frames) < 3 or min(weight.shape) < LEAST or spans(motion, weight) > SHARED:
        return motion
    small, factor = reduced(frames, weight)
    residual = relative(motion)
    turned, residual = turns(residual, weight), scaled(residual, factor)
    best = residual
    linear = best.clone() if model in STRETCHED else identity(len(motion))
    for start in starts(small, residual[1:, :2, 2].numpy(), turned):
        after = linear.clone()
        after[1:, :2, 2] = torch.from_numpy(likeliest_shifts(small, start))
        if factor * apart(best, after, small) >= APART and preferred(small, best, after):
            best = after
    return motion if best is residual else scaled(best, 1 / factor)


def reduced(frames: Tensor, weight: Tensor, size: int = SIZE) -> tuple[Tensor, int]:
    """Frames `(N, h, w)` as the likelihood looks at frames `(N, H, W)`, and how much smaller they are."""
    factor = max(1, min(-(-max(weight.shape) // size), min(weight.shape) // SIDE))
    return variance_stabilise(average(frames.float(), factor), average(weight[None], factor)[0]), factor


def scaled(motion: Tensor, factor: float) -> Tensor:
    """Motions `(N, 3, 3)` in px that are `factor` times as large."""
    scaled = motion.clone()
    scaled[:, :2, 2] /= factor
    scaled[:, 2, :2] *= factor
    return scaled


def turns(motion: Tensor, weight: Tensor) -> bool:
    """Whether relative motions `(N, 3, 3)` of frames that are as large as `weight` are no shifts."""
    return float((motion[:, :2, :2] - torch.eye(2)).abs().amax()) * max(weight.shape) / 2 > TURNED


def spans(motion: Tensor, weight: Tensor) -> float:
    """How far apart motions `(N, 3, 3)` put frames that are as large as `weight`, in shares of their sides."""
    shifts = motion[:, :2, 2] / torch.tensor(weight.shape[::-1])
    return float((shifts.amax(0) - shifts.amin(0)).max())


def starts(frames: Tensor, residual: np.ndarray, turned: bool) -> list[np.ndarray]:
    """Shifts `(N - 1, 2)` from which the likelihood climbs: where residuals are least, and elsewhere.

    A turn is no shift; but where the search was taken in by the pattern, it found a turn, as often as not.
    """
    found = [] if turned else [residual.copy()]
    if len(frames) > MOST:
        return found
    whole = integer_shifts(frames)
    return [*found, whole] if np.abs(whole - residual).max() > FAR else found


def apart(before: Tensor, after: Tensor, frames: Tensor) -> float:
    """How far motions `(N, 3, 3)` are apart at most, in px, at the corners of frames."""
    h, w = frames.shape[1:]
    corners = torch.tensor([[-w, w, w, -w], [-h, -h, h, h], [2, 2, 2, 2]], dtype=torch.float64) / 2
    return float((transform_points(after, corners) - transform_points(before, corners)).norm(dim=1).max())


def preferred(frames: Tensor, before: Tensor, after: Tensor) -> bool:
    """Whether all parts of frames but the one that gains most gain from motions `(N, 3, 3)` to others, in sum."""
    return all_but_one(gains(frames, before, after, FOUR)) >= 0
