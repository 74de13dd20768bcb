"""The offset of a sensor from frames that do not register as a whole: a camera that drives, among near things.

Dense displacements take the place of one motion for each frame. What a point of the scene changes in brightness along
its way tells the low-order part of the offset; the fine part is what all frames share.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA, block_sums, pattern_outliers
from deepir.multiview.texture_flow import Displacement, displacements, enlarged, sampled
from deepir.recording.burst import LEVEL_VARIANCES, FramePrior
from deepir.recording.defective_pixels import noise_deviation, of_neighbours
from deepir.recording.joint_solve import low_order_step
from deepir.recording.keyframes import spread
from deepir.recording.modes import (
    LowOrderModes,
    NormalEquations,
    PatternPrior,
    dct,
    idct,
    low_order_equations,
    mode_radius,
    shared_share,
)

REFERENCES = 20  # frames that others are compared with, at most
NEIGHBOURS = 6  # frames that each reference is compared with, at most
ROUNDS = 2  # of finding displacements, each after what was found before is taken off
RADIUS = 12.0  # half periods over the longer side, below which modes are found from displacements
DISPLACEMENT_ERROR = 0.4  # px, standard deviation
#: px, side of blocks, and strength of the fine part in one over the median one's, up to which it is the sensor's.
BLOCK, MAX_UNEVENNESS = 16, 1.2
MIN_KNOWN = 0.05  # share of a frame whose displacement is known, so that the frame is used


class DisplacedFrames:
    """A reference frame, and others whose points are displaced from it.

    Args:
        frames: (n, h, w), without what is known of the pattern; the reference first.
        found: displacements from the reference to each other frame.
        noise: standard deviation of a sample.
    """

    independent = False  # of other references, whose frames are partly the same

    def __init__(self, frames: Array, found: Sequence[Displacement], noise: float) -> None:
        self.noise, self.inflation = noise, 1.0
        self.levels, self.gains = np.zeros(len(frames)), np.ones(len(frames))
        self.frame_prior = FramePrior(LEVEL_VARIANCES[-1] * noise**2, self.gains)
        self.frame_priors = [self.frame_prior]
        self.common_error = np.zeros(frames.shape[1:])
        rows, columns = np.indices(frames.shape[1:], float)
        self._at = [(rows, columns), *((each.y, each.x) for each in found)]
        self._shown = np.stack([frames[0], *(sampled(f, *at) for f, at in zip(frames[1:], self._at[1:], strict=True))])
        slope = np.hypot(*np.gradient(ndimage.gaussian_filter(frames[0], 1.0)))
        variance = noise**2 + (DISPLACEMENT_ERROR * slope) ** 2
        known = np.stack([np.any([each.known for each in found], axis=0), *(each.known for each in found)])
        self._weights = known / variance
        scene = (self._weights * self._centred()).sum(0) / np.maximum(self._weights.sum(0), 1e-30)
        rest = self._centred() - scene
        scale = max(MAD_TO_SIGMA * float(np.median(np.abs(rest[known]))) if known.any() else 0.0, noise)
        self._weights /= 1 + (rest / (3 * scale)) ** 2

    def _centred(self) -> Array:
        """The frames on the reference, without the differences of their levels."""
        levels = [
            np.median((each - self._shown[0])[weight > 0]) if (weight > 0).any() else 0.0
            for each, weight in zip(self._shown, self._weights, strict=True)
        ]
        return np.asarray(self._shown - np.reshape(levels, (-1, 1, 1)))

    def equations(self, modes: LowOrderModes, offset: Array, gain: Array) -> NormalEquations:
        """Of the low-order part; offset and gain are taken off already."""

        def places(k: int, seen: Array) -> tuple[Array, Array]:
            weight = np.maximum(self._weights[k], 1e-30)
            total = block_sums(weight, modes.block)[seen]
            y, x = (block_sums(weight * each, modes.block)[seen] / total for each in self._at[k])
            return y, x

        return low_order_equations(self._shown, self._weights, places, modes)


def solve_low_order(frames: Array, neighbours: Sequence[Sequence[int]], start: Array) -> Array | None:
    """The low-order part (h, w) of an offset; None if it may as well be the scenes'.

    Args:
        frames: (N, h, w), float32, averaged over blocks.
        neighbours: of each frame, those that may show the same things displaced.
        start: (h, w), a pattern whose fine part is right, and whose low-order part is as strong as the sensor's.
    """
    size = frames.shape[1:]
    modes = LowOrderModes(size, RADIUS, slopes=False)
    prior = PatternPrior(dct(start.astype(float)))
    offset = start.astype(float)
    for _ in range(ROUNDS):
        rest = (frames - offset).astype(float)
        rest -= np.median(rest, axis=(1, 2), keepdims=True)
        sets = _displaced(rest, neighbours)
        if not sets:
            return None
        step, _ = low_order_step(sets, modes, prior, offset, np.ones(size))
        offset = offset + step
    found, scene = (dct(each)[modes.low] for each in (offset, frames.mean(0) - offset))
    # What the scenes share stays in it, mostly a multiple of their mean: what is stronger beside it is the sensor's.
    multiple = np.clip((found @ scene) / max(scene @ scene, 1e-30), 0, 1) * scene
    beside = found - multiple
    if beside @ beside < scene @ scene + multiple @ multiple:
        return None
    return low_order_part(offset)


def _displaced(frames: Array, neighbours: Sequence[Sequence[int]]) -> list[DisplacedFrames]:
    references = spread([k for k, others in enumerate(neighbours) if others], REFERENCES)
    pairs = [(k, other) for k in references for other in spread(neighbours[k], NEIGHBOURS)]
    noise = noise_deviation(frames.astype(np.float32))
    found = [each for each in displacements(frames, pairs) if each.known.mean() > MIN_KNOWN]
    return [
        DisplacedFrames(frames[[k, *(each.second for each in mine)]], mine, noise)
        for k in references
        if (mine := [each for each in found if each.first == k])
    ]


def fine_part(one: Array, other: Array) -> Array:
    """The fine part (h, w) of an offset that two patterns share, estimated from different stretches of a recording."""
    # A spike, as of a defective pixel, is in all modes: it is taken off before, and put back.
    spikes = pattern_outliers((one + other) / 2, np.ones(one.shape, bool))
    first, second = (dct(np.where(spikes, of_neighbours(each[None])[0], each)) for each in (one, other))
    mean, fine = (first + second) / 2, mode_radius(one.shape) >= RADIUS
    offset = idct(fine * dct(_stationary(idct(fine * shared_share(first, second) * mean))))
    return np.asarray(offset + np.where(spikes, (one + other) / 2 - idct(mean), 0.0))


def _stationary(offset: Array) -> Array:
    """A fine part (h, w), shrunk where it is stronger than elsewhere: there it is the edges of scenes that stood still.

    The pixels of a sensor are about as uneven everywhere; an excess is taken for the scenes', as by Wiener's filter.
    Columns and rows, which are long, are found by their medians and stay.
    """
    lines = np.median(offset, axis=0, keepdims=True)
    lines = lines + np.median(offset - lines, axis=1, keepdims=True)
    pixels, block = offset - lines, min(BLOCK, *offset.shape)
    height, width = (side // block for side in offset.shape)
    blocks = pixels[: height * block, : width * block].reshape(height, block, width, block)
    strength = np.median(np.abs(blocks), axis=(1, 3))
    share = np.minimum(1, (MAX_UNEVENNESS * np.median(strength) / np.maximum(strength, 1e-30)) ** 2)
    return np.asarray(lines + pixels * enlarged(share, offset.shape, block))


def low_order_part(pattern: Array) -> Array:
    """What a pattern (h, w) has beside a fine part."""
    return idct(np.where(mode_radius(pattern.shape) < RADIUS, dct(pattern.astype(float)), 0.0))
