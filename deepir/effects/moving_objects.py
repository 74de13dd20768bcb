"""Moving objects: samples that show an object in front of the scene."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy.ndimage import find_objects, label
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.arrays.statistics import masked_values, median, median_sigma
from deepir.arrays.windows import box_sum
from deepir.effects.effect import Effect
from deepir.messages import Message
from deepir.problem import Problem, Values
from deepir.registry import register

OBJECT_WEIGHT = 1e-5  # relative weight of a sample that shows an object, which may be hundreds of deviations off
MIN_GAP = 5.0  # robust standard deviations between two groups of frames at a place of an object
CLEAR_GAP = 12.0  # the same at one place at least of each object
MIN_COVERAGE = 0.3  # pixels of a frame that must see a place
WINDOW = 3  # px: side of the windows whose mean residual is compared
MIN_WIDTH = 5  # px: thinner regions are edges, no objects
BACKGROUND_SPREAD = 0.12  # of the gap, up to which the frames without the object agree; with parallax they do not
MAX_REGIONS = 8  # before scene and pattern have settled: more are parallax
SURROUNDINGS = 30  # px around all regions, by which the brightness of the scene is known
STRIDE = 3  # px between the places that a robust standard deviation is of

# Which group of frames shows the object.
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

Region = tuple[tuple[slice, ...], Tensor]  # a box of frames (N, H, W), and which places of it a region has


@torch.no_grad()
def down_weight_moving(problem: Problem, *, settled: bool = True) -> float:
    """Give samples of moving objects next to no weight; their contrast, 0 without an object.

    Samples that alone see the scene behind an object get their weight back: their residual is that of an object in the
    scene that the other frames show. See `detect_moving_objects`.
    """
    problem.moving.zero_()
    found = detect_moving_objects(problem, settled=settled)
    if found is None:
        return 0.0
    samples, alone, contrast = found
    problem.moving.copy_(samples)
    _restore_weight(problem, alone)
    problem.precision.mul_(torch.where(problem.moving, OBJECT_WEIGHT, 1.0))
    return contrast


@torch.no_grad()
def detect_moving_objects(problem: Problem, *, settled: bool = True) -> tuple[Tensor, Tensor, float] | None:
    """Detect moving objects by the residuals, carried to the scene's grid; None where nothing moves.

    Returns the samples that show an object, (N, 1, h, w), bool; those that alone see the scene behind one, same shape;
    and the median difference between object and scene, robust standard deviations.

    Where the frames fall into two groups at a place, an object is in front of the scene in one of them; `foreground`
    decides in which. Scene and pattern explain most of the frames. Once they have `settled`, places where the other
    frames still disagree are parallax.
    """
    values = problem.values()
    first, frames = problem.operator.named()[0][1], len(problem.data)
    instant = not any(stage.temporal for _, stage in problem.operator.named())
    same = first.moves and instant and len(values["scene"]) == 1
    if frames < 3 or not same or not all(stage.linear for _, stage in problem.operator.named()[:-1]):
        return None
    residual = problem.data - problem.predict(values)
    seen, known = _registered(problem, residual, values)
    usual = _usual(*(each[:, ::STRIDE, ::STRIDE] for each in (seen, known)))
    gap, middle = _widest_gap(seen, known, MIN_GAP * usual)
    regions = list(_regions(gap > MIN_GAP * usual, gap > CLEAR_GAP * usual))
    if not regions or (not settled and len(regions) >= MAX_REGIONS):
        return None
    shown = _shown(seen + box_sum(values["scene"], WINDOW)[0] / WINDOW**2, known, seen > middle, regions)
    passes, alone, contrasts = torch.zeros_like(seen), torch.zeros_like(seen), []
    for box, region in regions:
        among, gaps = known[box] & region, gap[box[1:]][region]
        here = shown[box] & region
        rest = among & ~here
        if settled and _differ(seen[box], rest) > BACKGROUND_SPREAD * gaps.median():
            continue
        passes[box] += here
        alone[box] += rest & (rest.sum(0) < here.sum(0))
        contrasts.append(gaps)
    if not contrasts:
        return None
    whole = _dilated(passes[:, None], 3)  # with its blurred edge
    samples, only = (problem.flux(values | {"scene": each}) > 0.5 for each in (whole, alone[:, None]))
    return samples, only, float(torch.cat(contrasts).median()) / usual


def _restore_weight(problem: Problem, samples: Tensor) -> None:
    """Give usable samples (N, 1, h, w), bool, at least the median precision."""
    usual = torch.full_like(problem.precision, median_sigma(problem.precision) ** -2)
    better = samples & (problem.precision > 0) & (problem.precision < usual)
    problem.precision.copy_(usual.where(better, problem.precision))


def _registered(problem: Problem, residual: Tensor, values: Values) -> tuple[Tensor, Tensor]:
    """Each frame's residual on the scene's grid, (N, H, W), means of windows, and where a frame sees it."""
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    shape = (len(residual), 1, *values["scene"].shape[-2:])
    usable = (problem.precision > 0).to(residual)
    total, weight = (
        box_sum(problem.operator.adjoint(each, shape, **slots), WINDOW) for each in (residual * usable, usable)
    )
    return (total / weight.clamp(min=1e-6))[:, 0], (weight > MIN_COVERAGE * WINDOW**2)[:, 0]


def _widest_gap(seen: Tensor, known: Tensor, least: float) -> tuple[Tensor, Tensor]:
    """The widest gap between the frames' values at each place (H, W), and its middle; zero if below `least`."""
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
    typical = median(masked_values(apart.abs_(), known & (count > 1)))
    return MAD_TO_SIGMA * typical * (len(seen) / (len(seen) - 1)) ** 0.5


def _regions(wide: Tensor, far: Tensor) -> Iterator[Region]:
    """Connected regions of `wide` places (H, W), nowhere thin, with a `far` one: a box of (N, H, W), and its places."""
    if not far.any():
        return
    thick = _dilated(1 - _dilated(1 - wide[None, None].float(), MIN_WIDTH), MIN_WIDTH)[0, 0] > 0.5
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
    """Frames (N, H, W), bool, that show an object in `regions`: those `above` the gap or those below."""
    inside = torch.zeros_like(known[0])
    for box, region in regions:
        inside[box[1:]] |= region
    held = (torch.nonzero(inside.any(axis))[:, 0] for axis in (1, 0))
    rows, columns = (slice(max(int(at[0]) - SURROUNDINGS, 0), int(at[-1]) + SURROUNDINGS + 1) for at in held)
    box = (slice(None), rows, columns)
    among, shown = known & inside, torch.zeros_like(known)
    shown[box] = foreground(flux[box], known[box], (among & above)[box], (among & ~above)[box])
    return shown


def foreground(flux: Tensor, known: Tensor, above: Tensor, below: Tensor) -> Tensor:
    """Which of two groups of frames shows the moving object, at each place, (N, H, W), bool.

    An object is in much the same frames as at nearby places, object and scene are as bright as there, and the object is
    in the smaller group. Places are decided in turns, until none changes (iterated conditional modes, Besag 1986).

    Args:
        flux: Frames on the scene's grid, (N, H, W).
        known: Frames that see a place, (N, H, W), bool.
        above: The brighter group of frames at each place, (N, H, W), bool; none outside objects.
        below: The darker group.
    """
    side = float((above | below).any(0).sum()) ** 0.5
    vote_side, level_side = (2 * round(share * side / 2) + 1 for share in (VOTE_WINDOW, LEVEL_WINDOW))
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
        of_object, of_scene = (_misfit(groups, flux, voting & some, least, level_side) for some in (shown, ~shown))
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
    count, total, squares = _box_sum(torch.stack([some.sum(0).to(flux), shown.sum(0), shown.square().sum(0)]), side)
    mean = total / count.clamp(min=1)
    variance = (squares / count.clamp(min=1) - mean.square()).clamp(min=0) + least
    return ((levels - mean).square() / (2 * variance)).clamp(max=MAX_LEVEL_MISFIT) * (count > MIN_SAMPLES)


def _box_sum(images: Tensor, side: int) -> Tensor:
    """Sums over the window of each pixel of images (N, H, W), as differences of cumulative sums."""
    for axis in (-1, -2):
        ends = (side // 2 + 1, side // 2)
        padded = F.pad(images, ends if axis == -1 else (0, 0, *ends)).cumsum(axis, dtype=torch.float64)
        length = padded.shape[axis] - side
        images = padded.narrow(axis, side, length) - padded.narrow(axis, 0, length)
    return images.float()


def _dilated(image: Tensor, side: int) -> Tensor:
    return F.max_pool2d(image, side, stride=1, padding=side // 2)


@register("effect", "moving_objects")
@dataclass(frozen=True)
class MovingObjectsMask(Effect):
    """Things that move by themselves: their samples hardly count.

    Args:
        min_contrast: Robust standard deviations between object and scene from which it is left out of the start.
        restart_contrast: The same from which scene and pattern are started anew, once the pattern is known.
    """

    compares_frames = True
    min_contrast: float = 12.0
    restart_contrast: float = 60.0

    def prepare(self, problem: Problem) -> None:
        problem.precision.mul_(~problem.moving)

    def initialise(self, problem: Problem) -> None:
        # A pixel that was given up beside the object stays so.
        alive = (problem.precision > 0).any(0) | problem.moving.all(0)
        problem.precision.add_(OBJECT_WEIGHT * median_sigma(problem.precision) ** -2 * (problem.moving & alive))

    def detect(self, problem: Problem) -> bool:
        found = detect_moving_objects(problem, settled=False)
        if found is None or found[-1] <= self.min_contrast:
            return False
        problem.moving.copy_(found[0])
        return True

    def update(self, problem: Problem, *, settled: bool) -> bool:
        return down_weight_moving(problem, settled=settled) > self.restart_contrast and not settled

    def finish(self, problem: Problem) -> None:
        down_weight_moving(problem)

    def messages(self, problem: Problem, *, complete: bool) -> Iterator[str]:
        if share := float(problem.moving.double().mean()):
            yield Message(
                "moving-object",
                f"something moves by itself: {share:.2%} of the samples show it and are left out ('moving' in "
                "result.npz); what it covers in most frames is estimated only in part",
            )
