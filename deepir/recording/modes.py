"""Cosine modes of an offset: the prior of all, and the normal equations of those of long periods.

One Gaussian holds the pattern at all scales. The variance of a mode depends on its period alone, and is larger where
the mode is a column or a row: rows and columns share electronics.

A point of the scene that n frames show has one brightness: it is eliminated, and what is left are differences between
the frames. Those are averaged over blocks of the canvas, so that the system of the modes of long periods, with the
levels, motions and gains of the frames, is small and is solved exactly, with its posterior covariance. Motion and level
are unknowns beside the offset: a slope of the offset looks like levels that follow the motion, and only the exact
posterior knows which of them the data determine.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

from deepir.arrays import Array
from deepir.arrays.samples import CHI_SQUARED_MEDIAN, block_sums
from deepir.recording.alignment import centred, step_gradients, weighted_mean

PSEUDO_COUNT = 2.0  # modes that the variance of a band so far counts as
#: Modes of a period longer than this, in px, start with a variance that grows with the square of the period.
WHITE_PERIOD = 8.0
#: Half periods over the longer side at which errors of two halves of a recording are twice as large in their mean as
#: independent ones: on pieces of a drive (Lynred) and simulated drives and walks.
COMMON_RADIUS = 23.0
BLOCKS = 40  # blocks along the longer side of a frame
MIN_WEIGHT = 1e-3  # of the best seen block's, from which a block counts
SCALES = (1, 2, 4, 8)  # blocks over which the misfit is averaged
CLIP = 6.0  # sigmas, of a block's misfit


def dct(values: Array) -> Array:
    """Orthonormal cosine transform over the last two axes."""
    return np.asarray(fft.dctn(values, norm="ortho", axes=(-2, -1)))


def idct(modes: Array) -> Array:
    """Its inverse."""
    return np.asarray(fft.idctn(modes, norm="ortho", axes=(-2, -1)))


def mode_radius(size: Sequence[int]) -> Array:
    """Half periods of each cosine mode over the longer side of a frame (h, w)."""
    down, across = (np.arange(side) * max(size) / side for side in size)
    return np.hypot(down[:, None], across)


class PatternPrior:
    """Variances of the cosine modes of a pattern (h, w), estimated by expectation maximisation.

    Args:
        modes: (h, w), of a pattern, to start from the finest pixels', columns' and rows' ones: the others continue
            their spectra.

    Attributes:
        start: (h, w), variance of each mode before the data; of the mean next to nothing, which no data determine.
        variance: (h, w), of each mode.
    """

    def __init__(self, modes: Array) -> None:
        self.groups = mode_groups(modes.shape)
        finest, white = mode_radius(modes.shape) > max(modes.shape) / 2, np.empty(modes.shape)
        for kind in range(3):
            of_kind = self.groups % 3 == kind
            white[of_kind] = max(float(np.median(modes[of_kind & finest] ** 2)) / CHI_SQUARED_MEDIAN, 1e-12)
        growth = (2 * max(modes.shape) / WHITE_PERIOD / np.maximum(mode_radius(modes.shape), 1)) ** 2
        self.start = white + white[-1, -1] * (np.maximum(1, growth) - 1)
        self.start[0, 0] = 1e-9 * float(white.min())
        self.variance = self.start.copy()

    def strengths(self, modes: Array, posterior: Array, among: Array) -> Array:
        """Variances of modes in a mask (h, w), by the means and posterior variances (h, w) of those of their group."""
        groups, start = self.groups[among], self.start[among]
        most = int(self.groups.max()) + 1
        known = np.bincount(groups, minlength=most)
        power = np.bincount(groups, (modes**2 + posterior)[among], most)
        before = np.bincount(groups, start, most) / np.maximum(known, 1)
        found = ((power + PSEUDO_COUNT * before) / (known + PSEUDO_COUNT))[groups]
        return np.asarray(np.where(start == self.start[0, 0], start, found))


def mode_groups(size: Sequence[int]) -> Array:
    """The group (h, w) of each mode, those of about one period; columns and rows have groups of their own."""
    band = np.floor(2 * np.log2(np.maximum(mode_radius(size), 1.0))).astype(int)  # half an octave each
    axis = np.zeros(band.shape, int)
    axis[1:, 0], axis[0, 1:] = 1, 2
    return 3 * band + axis


def shared_share(one: Array, other: Array) -> Array:
    """Share (h, w), between 0 and 1, of the mean of two estimates of a pattern that is the pattern's.

    Their errors are of the scenes, which have more in common the longer the period is.

    Args:
        one, other: modes of the two estimates, (h, w), from frames of different times.
    """
    common = 1 + (COMMON_RADIUS / np.maximum(mode_radius(one.shape), 1)) ** 2
    groups = mode_groups(one.shape)
    error, total = common * group_power((one - other) / 2, groups), group_power((one + other) / 2, groups)
    return np.asarray(np.clip(1 - error / np.maximum(total, np.finfo(float).tiny), 0, 1))


def directional_groups(size: Sequence[int]) -> Array:
    """The group (h, w) of each mode, those of about one period down and one across."""
    down, across = (np.ceil(2 * np.log2(np.arange(side) + 1)).astype(int) for side in size)
    return np.asarray(down[:, None] * (across.max() + 1) + across)


def group_power(modes: Array, groups: Array) -> Array:
    """Mean square (h, w) of modes (h, w) over those of each group (h, w)."""
    mean = np.bincount(groups.ravel(), modes.ravel() ** 2) / np.maximum(np.bincount(groups.ravel()), 1)
    return np.asarray(mean[groups])


class LowOrderModes:
    """Cosine modes of long periods, as functions of places, and what they lack of a slope along either axis.

    Where frames register, a slope of the offset looks like levels that follow the motion: of it, the data may determine
    nothing. Cut off after some modes, it would seem to be determined by what is cut off; so that part has a coefficient
    of its own.

    Args:
        size: (h, w) of the frame, px.
        most: half periods over the longer side, below which modes are of long periods.
        slopes: whether slopes have coefficients.

    Attributes:
        low: (h, w) bool, the K modes among all; the mean is none of them.
        count: K, and one for each slope that has a coefficient.
        block: side, px, over which a mode is averaged.
    """

    def __init__(self, size: Sequence[int], most: float, *, slopes: bool) -> None:
        radius = mode_radius(size)
        self.size, self.low = (size[0], size[1]), (radius < most) & (radius > 0)
        self._down, self._across = np.nonzero(self.low)
        self.block = max(2, round(max(size) / BLOCKS))
        self._slopes: list[tuple[int, Array, Array, float]] = []
        for axis, places in enumerate(centred(size) if slopes else ()):
            slope = dct(places)
            rest = np.where(self.low, 0.0, slope)
            norm = float(np.linalg.norm(rest))
            if not np.any(self.low, axis=1 - axis)[1:].all():
                self._slopes.append((axis, slope[self.low], rest / norm, norm))
        self.count = len(self._down) + len(self._slopes)

    def at(self, y: Array, x: Array) -> Array:
        """Means over blocks about places (rows and columns of the frame), (places, count)."""
        values = self._along(0, self._down, y) * self._along(1, self._across, x)
        rests = [
            ((y, x)[axis] - (self.size[axis] - 1) / 2 - values @ slope) / norm for axis, slope, _, norm in self._slopes
        ]
        return np.column_stack([values, *rests])

    def analyse(self, offset: Array) -> Array:
        """Coefficients (count,) of an offset (h, w)."""
        modes = dct(offset)
        return np.append(modes[self.low], [(rest * modes).sum() for _, _, rest, _ in self._slopes])

    def synthesise(self, coefficients: Array) -> Array:
        """The offset (h, w) of coefficients (count,)."""
        modes = self.on_modes(coefficients)
        for (_, _, rest, _), each in zip(self._slopes, coefficients[len(self._down) :], strict=True):
            modes += each * rest
        return idct(modes)

    def on_modes(self, coefficients: Array) -> Array:
        """Those of the K modes, in a map (h, w) of all; zero elsewhere."""
        modes = np.zeros(self.size)
        modes[self.low] = coefficients[: len(self._down)]
        return modes

    def variances(self, of_modes: Array) -> Array:
        """Variances (count,) of the coefficients, from those of all modes, (h, w)."""
        return np.append(of_modes[self.low], [(rest**2 * of_modes).sum() for _, _, rest, _ in self._slopes])

    def _along(self, axis: int, modes: Array, at: Array) -> Array:
        side, orders = self.size[axis], np.arange(modes.max() + 1)
        angle = np.pi * orders / side
        with np.errstate(invalid="ignore"):
            mean = np.sin(angle * self.block / 2) / (self.block * np.sin(angle / 2))
        mean[0] = 1.0
        values = np.cos(angle * (at[:, None] + 0.5)) * mean * np.where(orders == 0, 1, 2**0.5) / side**0.5
        return np.asarray(values[:, modes])


@dataclass(frozen=True)
class NormalEquations:
    """`matrix @ unknowns = score` of K coefficients and, of each frame, level, motion and gain, as far as unknown.

    Attributes:
        matrix, score: (K + n p, K + n p) and (K + n p,).
        per_frame: p, number of unknowns of a frame.
    """

    matrix: Array
    score: Array
    per_frame: int
    _rows: list[tuple[Array, Array, Array, Array]]  # of each frame: its blocks, design, weights, changes
    _seen: Array

    def inflation(self, unknowns: Array) -> float:
        """By which the misfit at the scale where it is largest exceeds the noise of the samples, at least one."""
        total, moment = np.zeros(int(self._seen.sum())), np.zeros(int(self._seen.sum()))
        rest = []
        modes, of_frames = np.split(unknowns, [len(self.score) - len(self._rows) * self.per_frame])
        of_frames = of_frames.reshape(len(self._rows), -1)
        for (inside, design, weight, change), own in zip(self._rows, of_frames, strict=True):
            rest.append(change - design @ np.concatenate([modes, own]))
            total[inside] += weight
            moment[inside] += weight * rest[-1]
        scene = moment / np.maximum(total, np.finfo(float).tiny)
        maps = np.zeros((len(rest), *self._seen.shape))
        counts, places = np.zeros(maps.shape), np.flatnonzero(self._seen)
        for k, ((inside, _, weight, _), values) in enumerate(zip(self._rows, rest, strict=True)):
            misfit = weight**0.5 * (values - scene[inside])
            maps[k].flat[places[inside]] = np.clip(misfit, -CLIP, CLIP)
            counts[k].flat[places[inside]] = 1
        return max(1.0, *(_mean_square(maps, counts, scale) for scale in SCALES))


def _mean_square(maps: Array, counts: Array, scale: int) -> float:
    """Of sums of standardised residuals over `scale` x `scale` blocks; one if they are independent."""
    sums, known = block_sums(maps, scale), block_sums(counts, scale)
    full = known > scale**2 / 2
    return float((sums[full] ** 2 / known[full]).mean()) if full.sum() > 2 * len(maps) else 1.0


def low_order_equations(
    frames: Array,
    weights: Array,
    places: Callable[[int, Array], tuple[Array, Array]],
    modes: LowOrderModes,
    offset: Array | None = None,
    *,
    with_motion: bool = False,
) -> NormalEquations:
    """The equations that frames give.

    Args:
        frames: corrected by what is known so far, on the canvas: (n, H, W).
        weights: inverse variances of the samples there, same shape.
        places: of a frame's number and a mask of blocks, the rows and columns in the frame that these blocks show, px.
        modes: of the offset.
        offset: (h, w), of the frames, if their gains are unknown; None: they are one.
        with_motion: whether an error of each frame's motion is unknown, a step of a homography.
    """
    block = modes.block
    scene = weighted_mean(frames, weights)
    weight, change = block_sums(weights, block), block_sums(weights * (frames - scene), block)
    change /= np.maximum(weight, np.finfo(float).tiny)
    seen = weight.sum(0) > MIN_WEIGHT * weight.sum(0).max()
    y, x, bright, gy, gx = (
        block_sums(each, block)[seen] / block**2 for each in (*centred(scene.shape), scene, *np.gradient(scene))
    )
    half = max(modes.size) / 2
    own = [np.ones_like(y), *(step_gradients(gy, gx, y / half, x / half) if with_motion else ())]
    per_frame, count = len(own) + (offset is not None), modes.count
    size = count + len(frames) * per_frame
    matrix, score = np.zeros((size, size)), np.zeros(size)
    sums, moment, total = np.zeros((len(y), size)), np.zeros(len(y)), weight.sum(0)[seen]
    shared, rows = np.s_[:count], []
    for k in range(len(frames)):
        inside = np.flatnonzero(weight[k][seen] > 0)
        at = [each[inside] for each in places(k, seen)]
        own_weight, values = weight[k][seen][inside], change[k][seen][inside]
        columns = [each[inside] for each in own]
        if offset is not None:
            columns.append(bright[inside] + ndimage.map_coordinates(offset, at, order=1, mode="nearest"))
        design, root = np.concatenate([modes.at(*at), np.stack(columns, 1)], 1), np.sqrt(own_weight)[:, None]
        half = root * design
        weighted = root * half
        mine = np.s_[count + k * per_frame : count + (k + 1) * per_frame]
        normal, slope = half.T @ half, weighted.T @ values
        matrix[shared, shared] += normal[shared, shared]
        matrix[mine, mine] = normal[count:, count:]
        matrix[shared, mine], matrix[mine, shared] = normal[shared, count:], normal[count:, shared]
        score[shared] += slope[shared]
        score[mine] = slope[count:]
        sums[inside, shared] += weighted[:, shared]
        sums[inside, mine] = weighted[:, count:]
        moment[inside] += own_weight * values
        rows.append((inside, design, own_weight, values))
    matrix -= sums.T @ (sums / total[:, None])  # the scene is eliminated
    score -= sums.T @ (moment / total)
    return NormalEquations((matrix + matrix.T) / 2, score, per_frame, rows, seen)
