"""What moves by itself: samples that show somebody who walks by, and not the scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import find_objects, label
from torch import Tensor

from deepir.arrays.noise_level import median_sigma
from deepir.arrays.statistics import MAD_TO_SIGMA, masked_values, median
from deepir.arrays.windows import box_sum
from deepir.effects.effect import Effect
from deepir.effects.foreground import foreground
from deepir.operators.base import slots_of
from deepir.problem import Problem, Values
from deepir.registry import register

APART = 5.0  # gap between the frames, in robust standard deviations, from which a place shows two things
FAR = 12.0  # the same, of one place at least of each region that does
SEEN = 0.3  # pixels of a frame that a place must be seen by
SMOOTH = 3  # px: side of the windows whose mean residual is looked at
THIN = 5  # px: what is thinner, an edge say, does not count as something that moves
AGREE = 0.12  # of the gap, within which the other frames agree in a region; with parallax they do not
MANY = 8  # regions, from which it is parallax, where the scene has not settled enough to tell by that
REACH = 30  # px around all of them, that tell how bright the scene is
SOME = 3  # each so manieth place along an axis is enough for a standard deviation
LITTLE = 1e-5  # weight of a sample that shows something else, which may be hundreds of deviations off

#: A box of frames (N, H, W), and which places of it a region has.
Region = tuple[tuple[slice, ...], Tensor]


@dataclass(frozen=True)
class MovingObjects:
    """What moves by itself: `samples` (N, 1, h, w), bool, that show it, and those that `alone` see the scene behind it.

    `apart`: by how many robust standard deviations it differs from the scene, in the median.
    """

    samples: Tensor
    alone: Tensor
    apart: float


@torch.no_grad()
def down_weight_moving(problem: Problem, *, settled: bool = True) -> float:
    """Let samples count next to nothing that show something that moves by itself; see `detect_moving_objects`.

    Returned is by how many robust standard deviations it differs; zero where nothing moves. Who alone sees the scene
    misfits what the others made of it, and is no longer doubted for that.
    """
    problem.moving.zero_()
    found = detect_moving_objects(problem, settled=settled)
    if found is None:
        return 0.0
    problem.moving.copy_(found.samples)
    _trust(problem, found.alone)
    problem.precision.mul_(torch.where(problem.moving, LITTLE, 1.0))
    return found.apart


@torch.no_grad()
def detect_moving_objects(problem: Problem, *, settled: bool = True) -> MovingObjects | None:
    """What moves by itself, by the residuals, carried to the scene's grid; None where nothing does.

    In a place where the frames are of two minds, something stands before the scene in some of them; in which, see
    `foreground`. Where the others still differ when he is out, it is the scene that bends, and nothing is found; unless
    the scene has not `settled` enough to tell.
    """
    values = problem.values()
    first, frames = problem.operator.named()[0][1], len(problem.data)
    instant = not any(stage.temporal for _, stage in problem.operator.named())
    same = first.moves and instant and len(values["scene"]) == 1
    if frames < 3 or not same or not all(stage.linear for _, stage in problem.operator.named()[:-1]):
        return None
    residual = problem.data - problem.predict(values)
    seen, known = _registered(problem, residual, values)
    usual = _usual(*(each[:, ::SOME, ::SOME] for each in (seen, known)))
    gap, middle = _widest_gap(seen, known, APART * usual)
    regions = list(_regions(gap > APART * usual, gap > FAR * usual))
    if not regions or (not settled and len(regions) >= MANY):
        return None
    shown = _shown(seen + box_sum(values["scene"], SMOOTH)[0] / SMOOTH**2, known, seen > middle, regions)
    passes, alone, apart = torch.zeros_like(seen), torch.zeros_like(seen), []
    for box, region in regions:
        among, gaps = known[box] & region, gap[box[1:]][region]
        here = shown[box] & region
        rest = among & ~here
        if settled and _differ(seen[box], rest) > AGREE * gaps.median():
            continue
        passes[box] += here
        alone[box] += rest & (rest.sum(0) < here.sum(0))
        apart.append(gaps)
    if not apart:
        return None
    whole = _dilated(passes[:, None], 3)  # with its blurred edge
    samples, only = (_in_frames(problem, each, values) > 0.5 for each in (whole, alone[:, None]))
    return MovingObjects(samples, only, float(torch.cat(apart).median()) / usual)


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
    usual = torch.full_like(problem.precision, median_sigma(problem.precision) ** -2)
    better = samples & (problem.precision > 0) & (problem.precision < usual)
    problem.precision.copy_(usual.where(better, problem.precision))


def _registered(problem: Problem, residual: Tensor, values: Values) -> tuple[Tensor, Tensor]:
    """Each frame's residual on the scene's grid, (N, H, W), means of windows, and where a frame sees it."""
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    shape = (len(residual), 1, *values["scene"].shape[-2:])
    usable = (problem.precision > 0).to(residual)
    total, weight = (
        box_sum(problem.operator.adjoint(each, shape, **slots), SMOOTH)
        for each in (residual * usable, usable)
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
    return (
        MAD_TO_SIGMA
        * median(masked_values(apart.abs_(), known & (count > 1)))
        * (len(seen) / (len(seen) - 1)) ** 0.5
    )


def _regions(wide: Tensor, far: Tensor) -> Iterator[Region]:
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


def _shown(flux: Tensor, known: Tensor, above: Tensor, regions: Sequence[Region]) -> Tensor:
    """Frames (N, H, W), bool, that show in `regions` what moves: those `above` the gap or those below."""
    inside = torch.zeros_like(known[0])
    for box, region in regions:
        inside[box[1:]] |= region
    held = (torch.nonzero(inside.any(axis))[:, 0] for axis in (1, 0))
    rows, columns = (slice(max(int(at[0]) - REACH, 0), int(at[-1]) + REACH + 1) for at in held)
    box = (slice(None), rows, columns)
    among, shown = known & inside, torch.zeros_like(known)
    shown[box] = foreground(flux[box], known[box], (among & above)[box], (among & ~above)[box])
    return shown


def _in_frames(problem: Problem, masks: Tensor, values: Values) -> Tensor:
    """Images (N, 1, H, W) on the scene's grid as each frame sees its own."""
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    for name, stage in problem.operator.named()[:-1]:
        masks = stage(masks, **slots_of(slots, name))
    return masks


def _dilated(image: Tensor, side: int) -> Tensor:
    return F.max_pool2d(image, side, stride=1, padding=side // 2)


@register("effect", "moving_objects")
@dataclass(frozen=True)
class MovingObjectsEffect(Effect):
    """Things that move by themselves: their samples hardly count.

    Args:
        min_contrast: Robust standard deviations between object and scene from which it is left out of the start.
        restart_contrast: The same from which scene and pattern are started anew, once the pattern is known.
    """

    min_contrast: float = 12.0
    restart_contrast: float = 60.0

    def prepare(self, problem: Problem) -> None:
        problem.precision.mul_(~problem.moving)

    def initialise(self, problem: Problem) -> None:
        problem.precision.add_(LITTLE * median_sigma(problem.precision) ** -2 * problem.moving)

    def detect(self, problem: Problem) -> bool:
        found = detect_moving_objects(problem, settled=False)
        if found is None or found.apart <= self.min_contrast:
            return False
        problem.moving.copy_(found.samples)
        return True

    def update(self, problem: Problem, *, settled: bool) -> bool:
        return down_weight_moving(problem, settled=settled) > self.restart_contrast and not settled

    def finish(self, problem: Problem) -> None:
        down_weight_moving(problem)

    def messages(self, problem: Problem) -> list[str]:
        return moving_message(problem)
