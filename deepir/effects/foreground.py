"""Which frames show somebody, and which the scene behind him, in places that show two things."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

#: Sides of windows, in those of a square as large as all places: of those from which a place learns in which frames
#: somebody stands, and of those that tell how bright he is, and how bright the scene.
NEAR, BESIDE = 0.21, 0.67
#: What counts: in which frames he stands nearby, from -1 to 1; how well a level goes with his and with the scene's, in
#: nats, of which a misfit has so many at most; and that his frames are the fewer.
VOTES, LEVELS, BOUND, FEWER = 2.0, 0.5, 2.0, 0.45
SPREAD = 0.05  # least variance of a level, in squares of the width of all that a place shows
FEW = 1 / 3  # of a place's frames
FEWEST = 5  # samples that tell a level
TURNS = 30  # at most


def foreground(flux: Tensor, known: Tensor, above: Tensor, below: Tensor) -> Tensor:
    """Frames (N, H, W), bool, that show somebody: in each place those `above` or those `below`, two groups of frames.

    `flux` holds the `known` frames on the scene's grid. He stands in much the same frames as nearby, he and the scene
    are as bright as there, and his frames are the fewer: places are decided by that in turns, until none changes
    (iterated conditional modes, Besag 1986).
    """
    near, beside = (_odd(share * float((above | below).any(0).sum()) ** 0.5) for share in (NEAR, BESIDE))
    flux = flux - flux[known].mean()  # small numbers, whose squares are exact
    count = (above.sum(0) + below.sum(0)).clamp(min=1)
    side = above.to(flux) - below.to(flux)
    groups = torch.stack([(flux * group).sum(0) / group.sum(0).clamp(min=1) for group in (above, below)])
    low, high = flux.where(known, torch.inf).amin(0), flux.where(known, -torch.inf).amax(0)
    least = (SPREAD * (high - low).square()).where(known.any(0), 1.0).clamp(min=1e-30)
    fewer = -FEWER * side.sum(0) / count
    shown = above.where(side.sum(0) <= 0, below)
    told = known & (shown.sum(0) <= FEW * count)  # first those where few frames show him
    for turn in range(TURNS):
        stands = _around((2 * shown.to(flux) - 1) * told, near) / _around(told.to(flux), near).clamp(min=1)
        votes = (side * stands).sum(0) / count
        his, scene = (_misfit(groups, flux, told & some, least, beside) for some in (shown, ~shown))
        told = known
        score = VOTES * votes + LEVELS * (scene[0] - his[0] - scene[1] + his[1]) + fewer
        before, shown = shown, above.where(score > 0, below)
        if turn and torch.equal(before, shown):
            break
    return shown


def _misfit(levels: Tensor, flux: Tensor, some: Tensor, least: Tensor, beside: int) -> Tensor:
    """Nats by which levels (K, H, W) differ from what `some` samples of (N, H, W) show `beside`, bounded."""
    shown = flux * some
    count, total, squares = _around(
        torch.stack([some.sum(0).to(flux), shown.sum(0), shown.square().sum(0)]), beside
    )
    mean = total / count.clamp(min=1)
    variance = (squares / count.clamp(min=1) - mean.square()).clamp(min=0) + least
    return ((levels - mean).square() / (2 * variance)).clamp(max=BOUND) * (count > FEWEST)


def _odd(side: float) -> int:
    return 2 * round(side / 2) + 1


def _around(images: Tensor, side: int) -> Tensor:
    """Sums over the window around each pixel of images (N, H, W), as differences of sums, however large it is."""
    for axis in (-1, -2):
        ends = (side // 2 + 1, side // 2)
        padded = F.pad(images, ends if axis == -1 else (0, 0, *ends)).cumsum(axis, dtype=torch.float64)
        length = padded.shape[axis] - side
        images = padded.narrow(axis, side, length) - padded.narrow(axis, 0, length)
    return images.float()
