"""The thermal lag of pixels, from runs of neighbouring frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.arrays.statistics import MAD_TO_SIGMA
from deepir.kernels.block_means import block_means
from deepir.multiview.texture_flow import Displacement, coarsening, displacements, sampled
from deepir.recording.defective_pixels import noise_deviation

Array = np.ndarray[Any, Any]

#: Of a run: two frames and their successors, four frames apart: a camera that shakes moves otherwise by then.
OFFSETS = (0, 1, 4, 5)
LENGTH = OFFSETS[-1] + 1
MAX_RUNS = 12  # that are kept, at most
DETAIL_SIGMA = 3.0  # px of the averaged frames; Gaussian over which the energy of detail is averaged
MIN_ENERGY = 3.0  # of detail that counts, in variances of the noise
STRIDE = 2  # px of the averaged frames, between places that are compared
MIN_PLACES = 30  # in a run of frames
MIN_RUNS = 4
#: Correlated places: the energy of detail is averaged.
CORRELATED = 4 * np.pi * DETAIL_SIGMA**2 / STRIDE**2
#: Limits of the cut-off, rad/px.
CUTOFF_LIMITS = (0.3, np.pi)
#: Time constants that are tried, in frames: 0.3 is 10 ms at 30 frames a second.
TIME_CONSTANTS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0, 1.4, 2.0])
#: Ratio of the fitted to the true time constant, as a window mixes moving and resting detail: 0.5 to 0.85 in simulated
#: recordings.
ESTIMATOR_BIAS = 0.7
#: Log-likelihood gain over no lag, nats, and time constant, frames, from which there is a lag. In 70 simulated
#: recordings with a lag of 0.3 frames the gain was 0 to 100 nats, without one at most 0.8 but for one of 1.4; a real
#: drive seemed to have 0.07 frames.
MIN_NATS, MIN_TIME_CONSTANT = 1.0, 0.12


class NeighbouringFrames:
    """Keeps some runs of frames, spread over the recording.

    Attributes:
        runs: frames (h, w) of each run, at `OFFSETS` from its first.
        numbers: of the first frame of each run.
    """

    def __init__(self) -> None:
        self.runs: list[list[Array]] = []
        self.numbers: list[int] = []
        self._every = 1

    def collect(self, recording: Iterable[Array]) -> Iterator[Array]:
        """Yield the frames (h, w) of a recording unchanged, and keep runs without a repeated frame."""
        recent: deque[Array] = deque(maxlen=LENGTH)
        met = 0
        for number, frame in enumerate(recording):
            yield frame
            if recent and np.array_equal(frame, recent[-1]):
                recent.clear()
            recent.append(frame)
            if len(recent) == LENGTH:
                if met % self._every == 0:
                    self._keep(number + 1 - LENGTH, [recent[k] for k in OFFSETS])
                met += 1
                recent.clear()

    def _keep(self, number: int, run: list[Array]) -> None:
        self.runs.append(run)
        self.numbers.append(number)
        if len(self.runs) > MAX_RUNS:
            del self.runs[1::2], self.numbers[1::2]
            self._every *= 2


@dataclass(frozen=True)
class ThermalLag:
    """Estimated thermal time constant.

    Attributes:
        time_constant: in the time from frame to frame.
        nats: log-likelihood gain over no lag.
    """

    time_constant: float
    nats: float

    @property
    def is_seen(self) -> bool:
        """Whether it exceeds the estimates for pixels without lag."""
        return self.time_constant >= MIN_TIME_CONSTANT and self.nats > MIN_NATS


def thermal_lag(runs: Sequence[Array]) -> ThermalLag | None:
    """Estimate the time constant of the pixels.

    Args:
        runs: corrected frames (4, h, w): two neighbours, and two later that show the same things.

    Returns:
        None where too little of them shows the same.
    """
    if len(runs) < MIN_RUNS:
        return None
    frames = np.nan_to_num(np.concatenate(runs), copy=False)
    factor = coarsening(frames.shape[1:])
    noise = noise_deviation(frames)
    coarse = block_means(frames, np.ones(frames.shape, bool), factor)
    pairs = [(4 * k + i, 4 * k + j) for k in range(len(runs)) for i, j in ((1, 0), (3, 2), (1, 3))]
    found = list(displacements(coarse, pairs))
    compared = []
    for k in range(len(runs)):
        energies = [_energies(frames[4 * k + i], factor, noise) for i in (1, 3)]
        each = _compared(energies, found[3 * k : 3 * k + 3], factor, MIN_ENERGY * noise**2)
        if each is not None:
            compared.append(each)
    if len(compared) < MIN_RUNS:
        return None
    cutoff = _cutoff(frames, noise)
    nats = np.array([sum(_nats(*each, cutoff * tau) for each in compared) for tau in TIME_CONSTANTS])
    best = int(nats.argmin())
    return ThermalLag(float(TIME_CONSTANTS[best]) / ESTIMATOR_BIAS, float(nats[0] - nats[best]))


def _cutoff(frames: Array, noise: float) -> float:
    """Frequency, rad/px, up to which the differences of neighbouring pixels of frames (N, h, w) have an even spectrum.

    An even spectrum up to c has the mean squared frequency c^2 / 3: energy of second differences over that of first.
    """
    first = second = 0.0
    for frame in frames[::4]:
        for axis in (0, 1):
            first += float((np.diff(frame, axis=axis) ** 2).mean()) - 2 * noise**2
            second += float((np.diff(frame, 2, axis=axis) ** 2).mean()) - 6 * noise**2
    return float(np.clip((3 * max(second, 0.0) / max(first, noise**2)) ** 0.5, *CUTOFF_LIMITS))


def _energies(frame: Array, factor: int, noise: float) -> Array:
    """Energy of the differences down and across of a frame (h, w), less that of noise, averaged over blocks."""
    squares = np.zeros((2, *frame.shape), np.float32)
    squares[0, :-1] = np.diff(frame, axis=0) ** 2
    squares[1, :, :-1] = np.diff(frame, axis=1) ** 2
    means = block_means(squares, np.ones(squares.shape, bool), factor)
    return np.stack([ndimage.gaussian_filter(each, DETAIL_SIGMA) for each in means]) - 2 * noise**2


def _compared(
    energies: Sequence[Array], found: Sequence[Displacement], factor: int, least: float
) -> tuple[Array, Array, Array] | None:
    """Where two frames show the same: change of the ratio of detail, and squared speeds (2, places) in either, px."""
    back, later_back, between = found
    speeds = [each.vectors**2 * factor**2 for each in (back, later_back)]
    known_later = sampled(later_back.known.astype(float), between.y, between.x) > 0.99
    y, x = np.nonzero(back.known & between.known & known_later)
    on_grid = (y % STRIDE == 0) & (x % STRIDE == 0)
    y, x = y[on_grid], x[on_grid]
    there = between.y[y, x], between.x[y, x]
    here, later = energies[0][:, y, x], np.stack([sampled(each, *there) for each in energies[1]])
    enough = (np.minimum(here, later) > least).all(0)
    if enough.sum() < MIN_PLACES:
        return None
    here, later = here[:, enough], later[:, enough]
    change = np.log(here[1] / here[0]) - np.log(later[1] / later[0])
    first, second = speeds[0][:, y, x], np.stack([sampled(each, *there) for each in speeds[1]])
    return change, first[:, enough], second[:, enough]


def _nats(change: Array, first: Array, second: Array, tail_length: float) -> float:
    """Negative log-likelihood of a run, by Cauchy's distribution."""

    def ratio(squared: Array) -> Array:
        """Logarithm of the energy of detail across over that down, of an even spectrum up to the cut-off."""
        tail = tail_length * np.sqrt(squared) + np.finfo(np.float32).eps
        down, across = np.log(np.arctan(tail) / tail)
        return np.asarray(across - down)

    scale = max(MAD_TO_SIGMA * float(np.median(np.abs(change - np.median(change)))), 1e-3)
    return float(np.log1p(((change - ratio(first) + ratio(second)) / scale) ** 2).sum() / CORRELATED)
