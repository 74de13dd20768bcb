"""What moves by itself: samples that show somebody who walks by, and not the scene."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import find_objects, label
from torch import Tensor

from deepir.defects import around
from deepir.median import median
from deepir.noise import MAD, typical_noise
from deepir.operators import Warp
from deepir.operators.base import own
from deepir.problem import Problem, Values
from deepir.thin import counted

APART = 5.0  # gap between the frames, in robust standard deviations, from which a place shows two things
FAR = 12.0  # the same, of one place at least of each region that does
FEW = 1 / 3  # share of a place's frames in which something that passes is few enough to be told by that
SEEN = 0.3  # pixels of a frame that a place must be seen by
SMOOTH = 3  # px: side of the windows whose mean residual is looked at
THIN = 5  # px: what is thinner, an edge say, does not count as something that moves
NEAR = 9  # px: side of the windows from which a place learns in which frames something stands there
SURE = 0.7  # of the surest place's votes, with which a place is decided before others
AGREE = 0.12  # of the gap, within which the other frames agree in a region; with parallax they do not
MANY = 8  # regions, from which it is parallax, where the scene has not settled enough to tell by that
SOME = 3  # each so manieth place along an axis is enough for a standard deviation
LITTLE = 1e-3  # weight of a sample that shows something else


@dataclass(frozen=True)
class Moving:
    """What moves by itself: `samples` (N, 1, h, w), bool, that show it, and those that `alone` see the scene behind it.

    `apart`: by how many robust standard deviations it differs from the scene, in the median.
    """

    samples: Tensor
    alone: Tensor
    apart: float


@torch.no_grad()
def doubt_moving(problem: Problem, *, settled: bool = True) -> float:
    """Let samples count next to nothing that show something that moves by itself; see `find_moving`.

    Returned is by how many robust standard deviations it differs; zero where nothing moves. Who alone sees the scene
    misfits what the others made of it, and is no longer doubted for that.
    """
    problem.moving.zero_()
    found = find_moving(problem, settled=settled)
    if found is None:
        return 0.0
    problem.moving.copy_(found.samples)
    _trust(problem, found.alone)
    problem.precision.mul_(torch.where(problem.moving, LITTLE, 1.0))
    return found.apart


@torch.no_grad()
def find_moving(problem: Problem, *, settled: bool = True) -> Moving | None:
    """What moves by itself, by the residuals, carried to the scene's grid; None where nothing does.

    In a place where the frames are of two minds, something stands before the scene in the fewer of them, if these are
    few. Who walks less far from frame to frame than he is wide covers some places in most frames, though: those follow
    the places beside them, as whoever stands there does so in much the same frames. Where the others still differ when
    he is out, it is the scene that bends, and nothing is found; unless the scene has not `settled` enough to tell.
    """
    values = problem.values()
    first, frames = problem.operator.named()[0][1], len(problem.data)
    same = isinstance(first, Warp) and first.instants.count(frames) == frames and len(values["scene"]) == 1
    if frames < 3 or not same or not all(stage.linear for _, stage in problem.operator.named()[:-1]):
        return None
    residual = problem.data - problem.predict(values)
    seen, known = _registered(problem, residual, values)
    usual = _usual(*(each[:, ::SOME, ::SOME] for each in (seen, known)))
    gap, middle = _widest_gap(seen, known, APART * usual)
    regions = list(_regions(gap > APART * usual, gap > FAR * usual))
    if not settled and len(regions) >= MANY:
        return None
    above = known & (seen > middle)
    passes, alone, apart = torch.zeros_like(seen), torch.zeros_like(seen), []
    for box, region in regions:
        among, gaps = known[box] & region, gap[box[1:]][region]
        here = _which_passes(above[box] & region, among & ~above[box])
        if settled and _differ(seen[box], among & (here == 0)) > AGREE * gaps.median():
            continue
        passes[box] += here
        rest = among * (1 - here)
        alone[box] += rest * (rest.sum(0) < here.sum(0))
        apart.append(gaps)
    if not apart:
        return None
    whole = _dilated(passes[:, None], 3)  # with its blurred edge
    samples, only = (_in_frames(problem, each, values) > 0.5 for each in (whole, alone[:, None]))
    return Moving(samples, only, float(torch.cat(apart).median()) / usual)


def moving_message(problem: Problem) -> list[str]:
    """A line if something was found to move by itself."""
    share = float(problem.moving.double().mean())
    if not share:
        return []
    return [
        f"something moves by itself: {share:.2%} of the samples show it and are left out ('moving' in result.npz); "
        "what it covers in most frames is told only in part"
    ]


def _trust(problem: Problem, samples: Tensor) -> None:
    """Let some samples (N, 1, h, w), bool, count as much as is usual, if they are usable."""
    usual = torch.full_like(problem.precision, typical_noise(problem.precision) ** -2)
    better = samples & (problem.precision > 0) & (problem.precision < usual)
    problem.precision.copy_(usual.where(better, problem.precision))


def _registered(problem: Problem, residual: Tensor, values: Values) -> tuple[Tensor, Tensor]:
    """Each frame's residual on the scene's grid, (N, H, W), means of windows, and where a frame sees it."""
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    shape = (len(residual), 1, *values["scene"].shape[-2:])
    usable = (problem.precision > 0).to(residual)
    total, weight = (
        around(problem.operator.adjoint(each, shape, **slots), SMOOTH) for each in (residual * usable, usable)
    )
    return (total / weight.clamp(min=1e-6))[:, 0], (weight > SEEN * SMOOTH**2)[:, 0]


def _widest_gap(seen: Tensor, known: Tensor, least: float) -> tuple[Tensor, Tensor]:
    """The widest gap between the frames' values at each place (H, W), and its middle; zero where all is nearer."""
    low, high = seen.where(known, torch.inf).amin(0), seen.where(known, -torch.inf).amax(0)
    apart = high - low > least
    gap, middle = torch.zeros_like(low), torch.zeros_like(low)
    order = seen[:, apart].where(known[:, apart], torch.inf).sort(0).values
    gap[apart], below = order.diff(dim=0).nan_to_num(nan=0, posinf=0).max(0)
    middle[apart] = order.gather(0, below[None])[0] + gap[apart] / 2
    return gap, middle


def _usual(seen: Tensor, known: Tensor) -> float:
    """Robust standard deviation of frames (N, h, w) from their mean at each place."""
    count = known.sum(0)
    apart = seen - (seen * known).sum(0) / count.clamp(min=1)
    return MAD * median(counted(apart.abs_(), known & (count > 1))) * (len(seen) / (len(seen) - 1)) ** 0.5


def _regions(wide: Tensor, far: Tensor) -> Iterator[tuple[tuple[slice, ...], Tensor]]:
    """Regions of `wide` places (H, W) that are nowhere thin and hold a `far` one: for each a box around it, of
    (N, H, W), and which places of the box it has."""
    if not far.any():
        return
    thick = _dilated(1 - _dilated(1 - wide[None, None].float(), THIN), THIN)[0, 0] > 0.5
    regions, _ = label(thick.cpu().numpy())
    held = np.unique(regions[(thick & far).cpu().numpy()])
    for number, (rows, columns) in enumerate(find_objects(regions), 1):
        if number in held:
            around_it = tuple(slice(max(side.start - 1, 0), side.stop + 1) for side in (rows, columns))
            yield (slice(None), *around_it), torch.from_numpy(regions[around_it] == number).to(wide.device)


def _differ(seen: Tensor, some: Tensor) -> float:
    """Median over places of the standard deviation among `some` frames of (N, H, W), two of them at least."""
    count = some.sum(0)
    apart = (seen - (seen * some).sum(0) / count.clamp(min=1)) * some
    spread = (apart.square().sum(0) / (count - 1).clamp(min=1)).sqrt()[count > 1]
    return float(spread.median()) if len(spread) else 0.0


def _which_passes(above: Tensor, below: Tensor) -> Tensor:
    """Frames (N, H, W), 1 or 0, that show something else: of those above and those below, in places of two minds.

    At the rim of such places it is these of which there are few; from there on inwards those that go best with what is
    decided nearby, the surest places first. (Inside, few may be the frames that see the scene between two steps.)
    """
    over, under = above.sum(0), below.sum(0)
    two = over + under > 0
    outermost = _dilated((~two)[None, None].float(), 3)[0, 0] > 0
    decided = two & outermost & (torch.minimum(over, under) <= FEW * (over + under))
    passes = (torch.where(over <= under, above, below) & decided).float()
    difference = below.float() - above.float()
    while True:
        # Of decided places nearby, those where a frame shows the scene less those where it does not.
        votes = (difference * around(((1 - 2 * passes) * decided)[:, None], NEAR)[:, 0]).sum(0)
        open_ones = votes.where(two & ~decided, 0).abs()
        if not open_ones.any():
            return passes
        now = open_ones >= SURE * open_ones.max()
        passes = torch.where(now, torch.where(votes > 0, above, below), passes)
        decided |= now


def _in_frames(problem: Problem, masks: Tensor, values: Values) -> Tensor:
    """Images (N, 1, H, W) on the scene's grid as each frame sees its own."""
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    for name, stage in problem.operator.named()[:-1]:
        masks = stage(masks, **own(slots, name))
    return masks


def _dilated(image: Tensor, side: int) -> Tensor:
    return F.max_pool2d(image, side, stride=1, padding=side // 2)
