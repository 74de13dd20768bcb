"""Where the fixed pattern of a recording jumps, as after a closure of the shutter.

The median gradients of the keyframes before a place and after it differ by the scenes' and, where the pattern jumps
there, by the pattern's. A drift differs everywhere by as much, a jump stands out. A scene that stands for a while makes
such differences too, but comes and goes over several keyframes, where a pattern changes between two.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.recording.consensus import sampled_gradients
from deepir.recording.pattern_shares import slopes

Array = np.ndarray[Any, Any]

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


def pattern_jumps(frames: Array) -> list[int]:
    """Numbers of the keyframes (N, h, w) that are the first with another fixed pattern, increasing."""
    count = len(frames)
    places = np.arange(MIN_KEYFRAMES, count - MIN_KEYFRAMES + 1)
    if len(places) < WINDOW:  # too few to know what is usual
        return []
    gradients = _gradients(frames)
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


def _gradients(frames: Array) -> Array:
    """Some of the differences of neighbouring pixels, (N, samples)."""
    height, width = frames.shape[1:]
    counts = (height - 1) * width, height * (width - 1)
    return sampled_gradients(frames, *(max(1, count // SAMPLES) for count in counts))


def _change(gradients: Array, place: int) -> float:
    """Mean difference of the median gradients before and after a place, in units of their errors."""
    before, after = gradients[max(0, place - WINDOW) : place], gradients[place : place + WINDOW]
    apart = np.abs(_median(before) - _median(after))
    apart = apart[np.isfinite(apart)]
    return float(apart.mean() if apart.size else 0.0) / (1 / len(before) + 1 / len(after)) ** 0.5


def _median(gradients: Array) -> Array:
    """Of each sample over frames, (samples,); NaN where none is known."""
    found = np.full(gradients.shape[1], np.nan, np.float32)
    known = np.isfinite(gradients).any(0)
    found[known] = np.nanmedian(gradients[:, known], 0)
    return found
