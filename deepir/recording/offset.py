"""The offset of a camera from frames of many scenes: the fine part from gradients, the low-order part from motion.

The gradients that frames share are the pattern's and, where the scenes have something in common, the scenes': sky above
and road below. Its low-order part is estimated again from changes of brightness along the scene's displacements.
The displacements are sought on frames less the pattern, for what is left of it holds them at rest. So the estimate is
made twice, the second time with the texture that registered frames have shown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.block_means import block_means
from deepir.multiview.low_order_part import LOW_ORDER_SIGMA, low_order_part
from deepir.multiview.low_order_pattern import coarsening, low_order_pattern
from deepir.multiview.texture_flow import TEXTURE_SIGMA, Displacement, displacements, motion_extent, sampled
from deepir.recording.keyframes import spread
from deepir.recording.responses import refine_gain_offset

Array = np.ndarray[Any, Any]

FIRST_STRIDE = 2  # the first estimate uses every second pair of frames
#: px of the averaged frames; Gaussian over which changes of brightness are averaged: many pairs allow more than few.
CHANGE_SIGMA = 2.0
RELATED_QUANTILE = (
    0.75  # over pairs of frames: a camera turns too fast at times, and some pairs show the same things
)
CUTOFF_PAIRS = 12  # pairs of frames by which the cut-off is chosen
MIN_COMMON = 200  # px of the averaged frames whose displacement has to be known in a pair
#: Ratio of the changes along displacements with a low cut-off to those with a high one, from which the texture in
#: between is the sensor's: 1.2 to 1.4 where it is, up to 1.03 where it is the scenes', in real and simulated drives.
MIN_AGREEMENT_RATIO = 1.1
#: px of the averaged frames that the scene has to move somewhere once, so that the place does not rest. With this the
#: share of the scenes' mean that is left in the offset is the share of the frame that rests, in six simulated
#: recordings and a real one.
MIN_SCENE_MOTION = 2.0
#: Where the camera turns only one way: px of the averaged frames that the scene moves along one axis at least, and what
#: it seems to move across, relative to that.
TURN_MOTION, CROSS_RATIO = 2.5, 0.2
COLUMN_SIGMA = 16.0  # px; of the Gaussian below which the columns' means are the scene's


@dataclass(frozen=True)
class SeparatedOffset:
    """An additive pattern.

    Attributes:
        fine: (h, w), without the low-order part.
        whole: (h, w), with it; None where the scenes do not move.
        displacements: of the scenes, between frames averaged over blocks.
        axis_at_rest: 0 or 1, along which the scenes do not move: `whole` is without the low-order part along it alone.
    """

    fine: Array
    whole: Array | None
    displacements: tuple[Displacement, ...]
    axis_at_rest: int | None = None


def separate_offset(
    frames: Array,
    usable: Array,
    known: Array,
    consensus: Array,
    pairs: Sequence[tuple[int, int]],
    level: float,
) -> SeparatedOffset:
    """Divide what frames share into the sensor's offset and the scenes' mean.

    Args:
        frames: (N, h, w), float32, finite.
        usable: (N, h, w) bool, which samples count.
        known: (h, w) bool, pixels that respond to the scene.
        consensus: (h, w), whose gradients frames share.
        pairs: numbers of frames that may show the same things displaced.
        level: median of the frames, in their units.
    """
    good = usable & known
    columns = _columns(consensus, known)
    cutoff = _cutoff(frames - consensus, good, consensus - columns, pairs)
    fine = consensus - low_order_part(consensus - columns, known, cutoff)
    masked, one = np.where(good, frames, np.nan).astype(np.float32), np.ones_like(consensus)
    offset = consensus
    found: tuple[Displacement, ...] = ()
    for some in (pairs[::FIRST_STRIDE], pairs):
        if found:
            offset = refine_gain_offset(masked, found, one, offset, level, with_gain=False)[1].astype(
                np.float32
            )
        low_order = low_order_pattern(
            frames - offset,
            good,
            some,
            rounds=1,
            removed=low_order_part(offset - columns, known, cutoff),
            change_sigma=CHANGE_SIGMA,
            quantile=RELATED_QUANTILE,
        )
        found = low_order.displacements
        if not low_order.related:
            return SeparatedOffset(fine, None, found)
        offset = (offset + low_order.offset).astype(np.float32)
    whole = offset - _scene_left((frames - offset).mean(0), known, found)
    if (axis := _axis_at_rest(found)) is not None:
        if axis == 1:  # columns too are the same in all frames: broad ones may be the scene's
            fine = consensus - low_order_part(consensus, known, cutoff)
        whole = whole - (whole - fine).mean(1 - axis, keepdims=True)
    return SeparatedOffset(fine, whole, found, axis)


def fine_offset(consensus: Array, known: Array) -> Array:
    """The part of a consensus (h, w) that is the sensor's in any case: columns, and what is finer than 4 px.

    Args:
        consensus: whose gradients frames share.
        known: (h, w) bool, pixels that respond to the scene.
    """
    return np.asarray(
        consensus - low_order_part(consensus - _columns(consensus, known), known, LOW_ORDER_SIGMA)
    )


def _columns(pattern: Array, known: Array) -> Array:
    """The detail of the mean of each column, (1, w): mostly the sensor's. Of rows a scene has some, as a horizon."""
    counts = known.sum(0)
    profile = np.where(known, pattern, 0).sum(0) / np.maximum(counts, 1)
    return np.asarray(profile - ndimage.gaussian_filter1d(profile, COLUMN_SIGMA))[None]


def _cutoff(rest: Array, good: Array, shared: Array, pairs: Sequence[tuple[int, int]]) -> float:
    """Gaussian sigma, px, beyond which what frames share may be the scenes'.

    Frames whose texture still holds the pattern's agree less along their displacements.

    Args:
        rest: (N, h, w), frames less what they share.
        good: (N, h, w) bool, which samples count.
        shared: (h, w), what they share, but for columns.
        pairs: numbers of frames that may show the same things displaced.
    """
    factor, known = coarsening(rest.shape[1:]), np.asarray(good.any(0))
    low, high = LOW_ORDER_SIGMA, TEXTURE_SIGMA * factor
    some = spread(pairs, CUTOFF_PAIRS)
    numbers = sorted({k for pair in some for k in pair})
    coarse = block_means(rest[numbers], good[numbers], factor)
    placed = [(numbers.index(i), numbers.index(j)) for i, j in some]
    low_order = np.stack([low_order_part(shared, known, cutoff) for cutoff in (low, high)])
    found = [
        displacements(coarse + each, placed)
        for each in block_means(low_order, np.stack([known, known]), factor)
    ]
    ratios = []
    for one, other in zip(*found, strict=True):
        common = one.known & other.known
        if common.sum() >= MIN_COMMON:
            ratios.append(agreement(coarse, one, common) / agreement(coarse, other, common))
    return high if ratios and np.median(ratios) > MIN_AGREEMENT_RATIO else low


def agreement(frames: Array, found: Displacement, where: Array) -> float:
    """Robust deviation of the change of brightness along a displacement, less its low-order part."""
    change = frames[found.first] - sampled(frames[found.second], found.y, found.x)
    change = np.where(where, change - np.median(change[where]), 0.0)
    share = ndimage.gaussian_filter(where.astype(float), TEXTURE_SIGMA)
    low_order = ndimage.gaussian_filter(change, TEXTURE_SIGMA) / np.maximum(share, np.finfo(float).tiny)
    return max(MAD_TO_SIGMA * float(np.median(np.abs(change - low_order)[where])), np.finfo(float).tiny)


def _scene_left(mean: Array, known: Array, found: Sequence[Displacement]) -> Array:
    """Low-order part of the scenes' mean (h, w) that remains in an offset: times the share of the frame that rests.

    Where the scene never moves, as the sky of a drive, nothing separates it from the pattern.
    """
    sigma = TEXTURE_SIGMA * coarsening(mean.shape)
    return np.asarray(_share_at_rest(found) * low_order_part(mean, known, sigma), np.float32)


def _share_at_rest(found: Sequence[Displacement]) -> float:
    """Share of the frame where no displacement is known that is as long as `MIN_SCENE_MOTION`."""
    moved = np.zeros(found[0].known.shape, bool)
    for each in found:
        moved |= each.known & (np.hypot(*each.vectors) >= MIN_SCENE_MOTION)
    return float(1 - moved.mean())


def _axis_at_rest(found: Sequence[Displacement]) -> int | None:
    """The axis along which the scene does not move while it moves across, if any."""
    extent = motion_extent(found)
    for axis in (0, 1):
        if extent[1 - axis] >= TURN_MOTION and extent[axis] < CROSS_RATIO * extent[1 - axis]:
            return axis
    return None
