"""Segments of a recording with one pattern each, between jumps of the pattern."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from deepir.arrays import Array
from deepir.arrays.samples import as_float32
from deepir.calibration import CorrectionMaps
from deepir.errors import DataError
from deepir.kernels import memory, threads
from deepir.multiview.pattern_gradients import contains_pattern, removes_more, sampled_gradients, slopes
from deepir.recording.burst import CameraAtRestError
from deepir.recording.estimate import SensorEstimate, estimate_sensor
from deepir.recording.keyframes import Keyframes, spread

WINDOW = 12  # keyframes on either side
MIN_KEYFRAMES = 8  # between two jumps, and to the ends
SAMPLES = 4000  # gradients along each axis that are looked at
#: Difference across a place, relative to the median over all places, from which the pattern may jump. In real and
#: simulated recordings it was 1.2 to 3.4 where a shutter had closed, and up to 1.3 where a film's codec begins anew.
MIN_RATIO = 1.35
REACH = 2  # keyframes by which the place is uncertain
#: Share of the difference that is between two keyframes, where the pattern jumps. It was 0.44 to 0.97 at 12 jumps, and
#: 0.01 to 0.35 at 37 of 38 other places with a large difference.
MIN_STEP = 0.4
MIN_SLOPE = 0.5  # of the frames' change over their difference, which is noise where it is smaller
FRAMES_TO_FIT = 5  # of a segment, which maps of another one have to fit
MIN_MOVING = 16  # keyframes in which the camera moves, that a sensor is estimated from


def pattern_jumps(frames: Array) -> list[int]:
    """Numbers of the keyframes (N, h, w) that are the first with another fixed pattern, increasing."""
    places = np.arange(MIN_KEYFRAMES, len(frames) - MIN_KEYFRAMES + 1)
    if len(places) < WINDOW:  # too few to know what is usual
        return []
    height, width = frames.shape[1:]
    counts = (height - 1) * width, height * (width - 1)
    gradients = sampled_gradients(frames, *(max(1, each // SAMPLES) for each in counts))
    change = np.array([_change(gradients, int(place)) for place in places])
    usual = float(np.median(change))
    found: list[int] = []
    while usual and change.max() > MIN_RATIO * usual:
        index = int(change.argmax())
        if place := _step(gradients, int(places[index])):
            found.append(place)
        change[max(0, index - WINDOW) : index + WINDOW] = 0  # whose windows have this jump too
    return sorted(found)


def _step(gradients: Array, place: int) -> int | None:
    """The keyframe near a place, at which most of the change of the gradients (N, samples) comes at once."""
    before = gradients[max(0, place - REACH - WINDOW) : place - REACH]
    after = gradients[place + REACH : place + REACH + WINDOW]
    change = (_median(after) - _median(before))[None]
    slope = slopes(after, change)[0] - slopes(before, change)[0]
    near = range(place - REACH, place + REACH + 1)
    steps = [float(slopes(gradients[[k]] - gradients[[k - 1]], change)[0][0]) for k in near]
    if slope[0] < MIN_SLOPE or max(steps) < MIN_STEP * slope[0]:
        return None
    return near[int(np.argmax(steps))]


def _change(gradients: Array, place: int) -> float:
    """Mean difference of the median gradients before and after a place, in units of their errors."""
    before, after = gradients[max(0, place - WINDOW) : place], gradients[place : place + WINDOW]
    apart = np.abs(_median(before) - _median(after))
    apart = apart[np.isfinite(apart)]
    return float(apart.mean() if apart.size else 0.0) / (1 / len(before) + 1 / len(after)) ** 0.5


def _median(gradients: Array) -> Array:
    """Of each sample over frames, (samples,); NaN where none is known."""
    ordered, known = np.sort(gradients, axis=0), (~np.isnan(gradients)).sum(0)  # NaN is last
    middle = np.stack([np.maximum(known - 1, 0) // 2, known // 2])
    return np.asarray(np.take_along_axis(ordered, middle, 0).mean(0))


@dataclass(frozen=True)
class Segment:
    """Frames with one fixed pattern.

    Attributes:
        first, last: numbers of its first and last keyframe.
        estimate: of the sensor; None where it cannot be estimated, and frames stay as they are.
        refused: why not; empty with an estimate.
    """

    first: int
    last: int
    estimate: SensorEstimate | None
    refused: str = ""

    def correct(self, frame: Array, number: int | None = None) -> Array:
        """Correct a frame (h, w), in the recording's units; float32.

        Args:
            frame: of the recording, or after it.
            number: in the recording; None: after it. An automatic gain control scales the pattern of each frame.
        """
        found = self.estimate
        if found is None:
            return as_float32(frame)
        if found.contrasts is not None:
            contrast = np.interp(self.last if number is None else number, *found.contrasts)
            frame = as_float32(frame) - np.float32(contrast - 1) * found.offset.astype(np.float32)
        return self.maps.correct(frame)

    @property
    def description(self) -> str:
        """Which frames, and what is corrected of them."""
        what = self.estimate.kept if self.estimate else f"left as recorded: {self.refused}"
        return f"frames {self.first} to {self.last}: {what}"

    @functools.cached_property
    def maps(self) -> CorrectionMaps:
        """Gain, offset and bad pixels, as `deepir apply` takes them: frame = gain scene + offset."""
        found = self.estimate
        if found is None:
            raise DataError(self.refused)
        return CorrectionMaps(found.gain, found.offset + found.level * (1 - found.gain), found.bad_pixels)


def estimate_segments(keyframes: Keyframes, *, former: CorrectionMaps | None = None) -> list[Segment]:
    """Find where the pattern jumps, and estimate the sensor of each part.

    Args:
        keyframes: of a recording.
        former: see `estimate_sensor`.

    Raises:
        DataError: No part can be corrected; the reason of the first.
    """
    with threads.for_samples(keyframes.frames.size), memory.kept():
        return _estimate_segments(keyframes, former)


def _estimate_segments(keyframes: Keyframes, former: CorrectionMaps | None) -> list[Segment]:
    jumps = pattern_jumps(keyframes.frames)
    try:
        whole = _estimate(keyframes, former, keyframes.numbers[jumps].tolist())
        if not whole.jumps:
            return [_segment(keyframes, whole)]
        jumps = np.searchsorted(keyframes.numbers, whole.jumps).tolist()
    except DataError:
        if not jumps:
            raise
    parts = [np.arange(*each) for each in itertools.pairwise([0, *jumps, len(keyframes.frames)])]
    found, refused = [], []
    for part in parts:
        some = keyframes.subset(part)
        try:
            found.append(_segment(some, _estimate(some, former)))
        except DataError as error:
            refused.append(error)
            found.append(_segment(some, None, str(error)))
    if len(refused) == len(parts):
        raise refused[0]
    return [
        each if each.estimate else _with_maps_of_neighbour(each, found[max(0, k - 1) : k + 2], keyframes.frames[part])
        for k, (each, part) in enumerate(zip(found, parts, strict=True))
    ]


def _with_maps_of_neighbour(segment: Segment, neighbours: Sequence[Segment], frames: Array) -> Segment:
    """A segment without maps, with those of one before or after it that fit its frames (N, h, w), if any do."""
    some = spread(list(frames), FRAMES_TO_FIT)
    for each in neighbours:
        found = each.estimate
        if found and all(contains_pattern(frame, each.correct(frame), found.bad_pixels) for frame in some):
            return replace(segment, estimate=found, refused="")
    return segment


def _estimate(keyframes: Keyframes, former: CorrectionMaps | None, jumps: Sequence[int] = ()) -> SensorEstimate:
    """From all keyframes, or from those in which the camera moves, if it stands in most of them."""
    try:
        return estimate_sensor(keyframes, former=former, jumps=jumps)
    except CameraAtRestError:
        moving = keyframes.moving()
        if not MIN_MOVING <= len(moving.frames) < len(keyframes.frames):
            raise
        return estimate_sensor(moving, former=former, jumps=jumps)


def _segment(keyframes: Keyframes, estimate: SensorEstimate | None, refused: str = "") -> Segment:
    return Segment(int(keyframes.numbers[0]), int(keyframes.numbers[-1]), estimate, refused)


def segment_at(segments: Sequence[Segment], number: int, frame: Array) -> Segment:
    """The segment of a frame; of frames between two keyframes of different patterns, that which leaves it smoother."""
    for here, after in itertools.pairwise(segments):
        if number <= here.last:
            return here
        if number < after.first:
            bad = np.any([each.estimate.bad_pixels for each in (here, after) if each.estimate], axis=0)
            return after if removes_more(here.correct(frame), after.correct(frame), bad) else here
    return segments[-1]
