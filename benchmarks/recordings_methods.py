"""Methods that correct a recording, each a function of frames (N, h, w): ours, and rivals with their defaults."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rivals import OVER_TIME

import deepir
from deepir.baselines.gradients import gradient_consensus, multiview_tv
from deepir.baselines.pixel_statistics import basic
from deepir.baselines.rival import last_of
from deepir.calibration import CorrectionMaps

Array = np.ndarray

BURST = 10  # frames of a burst


@dataclass(frozen=True)
class Correction:
    """Of a recording.

    Attributes:
        correct: Corrects a frame (h, w) of a number.
        bad_pixels: (h, w) bool; None where the method seeks none.
        deviation: (h, w), stated standard deviation of the offset; None where nothing is stated.
        offset: (h, w), for which it is stated; None: for the mean of what is taken off the frames.
        kept: What was corrected, in words.
        maps: Gain and offset (h, w) of other frames of the camera.
    """

    correct: Callable[[Array, int], Array]
    bad_pixels: Array | None = None
    deviation: Array | None = None
    offset: Array | None = None
    kept: str = ""
    maps: tuple[Array | float, Array] | None = None

    def error(self, pattern: Array, of_frames: Array) -> Array:
        """Error (h, w) of that for which the deviation is stated; `of_frames` is the mean one of corrected frames."""
        return of_frames if self.offset is None else self.offset - pattern


Method = Callable[[Array, int], Correction]  # of frames, and the frames between two of a burst of one scene


def correct(frames: Array, apart: int) -> Correction:
    """`deepir correct`."""
    found = deepir.correct(frames)
    parts = f", {len(found.segments)} segments" if len(found.segments) > 1 else ""
    sensor, maps = found.estimate, (found.maps.gain, found.maps.offset)
    kept = sensor.kept + parts
    return Correction(found.correct, sensor.bad_pixels, sensor.offset_deviation, sensor.offset, kept, maps)


def burst(problem: str, frames: Array, apart: int) -> Correction:
    """A problem for bursts, on ten frames from the middle of the recording."""
    span = (BURST - 1) * apart + 1
    first = max(0, (len(frames) - span) // 2)
    used = list(range(first, min(first + span, len(frames)), apart))
    return _run(problem, frames, used)


def spread_burst(problem: str, frames: Array, apart: int) -> Correction:
    """A problem for frames of different scenes, on ten frames of the whole recording."""
    return _run(problem, frames, np.linspace(0, len(frames) - 1, BURST).astype(int).tolist())


def _run(problem: str, frames: Array, used: list[int]) -> Correction:
    result = deepir.run(problem, frames=frames, data={"frames": used})
    maps = CorrectionMaps(result.gain, result.offset, result.bad_pixels)
    deviation = getattr(result, "offset_deviation", None)
    return Correction(
        lambda frame, number: maps.correct(frame), result.bad_pixels, deviation, maps=(result.gain, result.offset)
    )


def _of_maps(gain: Array | float, offset: Array) -> Correction:
    return Correction(lambda frame, number: (frame - offset) / gain, maps=(gain, offset))


def _offset(estimate: Callable[[Array], Array], frames: Array, apart: int) -> Correction:
    return _of_maps(1.0, estimate(frames.astype(np.float32)))


def _over_time(name: str, frames: Array, apart: int) -> Correction:
    return _of_maps(*last_of(OVER_TIME[name](frames.astype(np.float32))))


def temporal_mean(frames: Array) -> Array:
    mean = frames.mean(0, dtype=np.float64)
    return mean - mean.mean()


#: Their figures change with any part of the package.
OURS: dict[str, Method] = {
    "correct": correct,
    "nuc": functools.partial(burst, "nuc"),
    "flow": functools.partial(burst, "flow"),
    "multiview_nuc": functools.partial(spread_burst, "multiview_nuc"),
}
RIVALS: dict[str, Method] = {
    "multiview_tv": functools.partial(_offset, multiview_tv),
    "gradient_consensus": functools.partial(_offset, gradient_consensus),
    "basic": lambda frames, apart: _of_maps(*basic(frames)),
    "temporal_mean": functools.partial(_offset, temporal_mean),
    **{name: functools.partial(_over_time, name) for name in OVER_TIME},
}
METHODS = OURS | RIVALS
