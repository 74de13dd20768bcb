"""Which frames show a moving object, and which the scene behind it, at places that show both."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

VOTE_WINDOW = 0.21  # side of the window of votes, relative to a square as large as all places
LEVEL_WINDOW = 0.67  # the same of the window in which brightness is compared
VOTE_WEIGHT = 2.0  # of the votes of nearby places, from -1 to 1
LEVEL_WEIGHT = 0.5  # of the log-likelihood ratio of the brightness, nats
MAX_LEVEL_MISFIT = 2.0  # nats
MINORITY_WEIGHT = 0.45  # of the object being in the smaller group of frames
MIN_LEVEL_VARIANCE = 0.05  # in squares of the range of all that a place shows
MINORITY_SHARE = 1 / 3  # of a place's frames, from which votes are taken first
MIN_SAMPLES = 5  # for the brightness of a window
MAX_TURNS = 30


def foreground(flux: Tensor, known: Tensor, above: Tensor, below: Tensor) -> Tensor:
    """Which of two groups of frames shows the moving object, at each place.

    An object is in much the same frames as at nearby places, object and scene are as bright as there, and the object is
    in the smaller group. Places are decided in turns, until none changes (iterated conditional modes, Besag 1986).

    Args:
        flux: Frames on the scene's grid, (N, H, W).
        known: Frames that see a place, (N, H, W), bool.
        above: The brighter group of frames at each place, (N, H, W), bool; none outside objects.
        below: The darker group.

    Returns:
        Frames that show the object, (N, H, W), bool.
    """
    vote_side, level_side = (
        _odd(share * float((above | below).any(0).sum()) ** 0.5) for share in (VOTE_WINDOW, LEVEL_WINDOW)
    )
    flux = flux - flux[known].mean()  # small numbers, whose squares are exact
    count = (above.sum(0) + below.sum(0)).clamp(min=1)
    side = above.to(flux) - below.to(flux)
    groups = torch.stack([(flux * group).sum(0) / group.sum(0).clamp(min=1) for group in (above, below)])
    low, high = flux.where(known, torch.inf).amin(0), flux.where(known, -torch.inf).amax(0)
    least = (MIN_LEVEL_VARIANCE * (high - low).square()).where(known.any(0), 1.0).clamp(min=1e-30)
    minority = -MINORITY_WEIGHT * side.sum(0) / count
    shown = above.where(side.sum(0) <= 0, below)
    voting = known & (shown.sum(0) <= MINORITY_SHARE * count)  # first where few frames show the object
    for turn in range(MAX_TURNS):
        ballot = (2 * shown.to(flux) - 1) * voting
        mean_vote = _box_sum(ballot, vote_side) / _box_sum(voting.to(flux), vote_side).clamp(min=1)
        votes = (side * mean_vote).sum(0) / count
        of_object, of_scene = (
            _misfit(groups, flux, voting & some, least, level_side) for some in (shown, ~shown)
        )
        voting = known
        ratio = of_scene[0] - of_object[0] - of_scene[1] + of_object[1]
        score = VOTE_WEIGHT * votes + LEVEL_WEIGHT * ratio + minority
        before, shown = shown, above.where(score > 0, below)
        if turn and torch.equal(before, shown):
            break
    return shown


def _misfit(levels: Tensor, flux: Tensor, some: Tensor, least: Tensor, side: int) -> Tensor:
    """Nats by which levels (K, H, W) differ from the mean of `some` samples (N, H, W) in a window; bounded."""
    shown = flux * some
    count, total, squares = _box_sum(
        torch.stack([some.sum(0).to(flux), shown.sum(0), shown.square().sum(0)]), side
    )
    mean = total / count.clamp(min=1)
    variance = (squares / count.clamp(min=1) - mean.square()).clamp(min=0) + least
    return ((levels - mean).square() / (2 * variance)).clamp(max=MAX_LEVEL_MISFIT) * (count > MIN_SAMPLES)


def _odd(side: float) -> int:
    return 2 * round(side / 2) + 1


def _box_sum(images: Tensor, side: int) -> Tensor:
    """Sums over the window of each pixel of images (N, H, W), as differences of cumulative sums."""
    for axis in (-1, -2):
        ends = (side // 2 + 1, side // 2)
        padded = F.pad(images, ends if axis == -1 else (0, 0, *ends)).cumsum(axis, dtype=torch.float64)
        length = padded.shape[axis] - side
        images = padded.narrow(axis, side, length) - padded.narrow(axis, 0, length)
    return images.float()
