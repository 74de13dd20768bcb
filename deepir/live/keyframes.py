"""Keyframes of frames that come: the newest ones while there are few, groups that are spread over time afterwards."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from deepir.recording.keyframes import (
    WINDOW,
    Chosen,
    ChosenFrames,
    KeyframeCollector,
    in_groups,
    motion_spacing,
)

Array = np.ndarray[Any, Any]

MAX_NEWEST = 64  # newest frames that are kept
MIN_IN_GROUPS = 32  # keyframes in groups, below which the newest frames count too
MAX_PENDING = 16  # frames since the camera last moved that are kept, in case it goes on
#: Change since then, relative to that between frames, from which it moves: of a camera that stands still it is 1.
MIN_CHANGE_RATIO = 1.5
Averaged = tuple[int, Array, Array]  # number, frame (h, w), the frame averaged over blocks


class LiveKeyframes:
    """Chooses keyframes, the first of them at once."""

    def __init__(self) -> None:
        self._groups = KeyframeCollector(latest=True)
        self._newest: deque[Averaged] = deque(maxlen=MAX_NEWEST)
        self._pending: deque[Averaged] = deque(maxlen=MAX_PENDING)
        self._steps: deque[float] = deque(maxlen=WINDOW)  # changes from frame to frame
        self._before: Array | None = None  # the last frame, averaged
        self._taken = 0

    @property
    def length(self) -> int:
        """Frames so far."""
        return self._groups.length

    @property
    def taken(self) -> int:
        """Keyframes chosen since the start, those that were dropped included."""
        return self._taken + self._groups.taken

    @property
    def count(self) -> int:
        """About as many keyframes are there now."""
        return max(len(self._newest), self._groups.count)

    def add(self, frame: Array) -> None:
        """The next frame (h, w); one that repeats the frame before it is no keyframe."""
        small = self._groups.add(frame)
        if small is None:
            return
        if self._before is not None:
            self._steps.append(_change(small, self._before))
        self._before = small
        self._pending.append((self.length - 1, frame, small))
        if not self._newest or _change(small, self._newest[-1][2]) > MIN_CHANGE_RATIO * np.median(
            self._steps
        ):
            self._taken += min(len(self._pending), MAX_NEWEST - len(self._newest))
            self._newest.extend(self._pending)
            self._pending.clear()

    def forget(self, number: int) -> None:
        """Drop the keyframes before a frame."""
        self._groups.forget(number)
        for frames in (self._newest, self._pending):
            while frames and frames[0][0] < number:
                frames.popleft()

    def chosen(self) -> ChosenFrames:
        """Those that are there now; at least one."""
        groups = self._groups.groups
        if self._groups.count < MIN_IN_GROUPS:
            first = self._newest[0][0]
            groups = [group for group in groups if group[-1][0] < first] + in_groups(self._spaced())
        return ChosenFrames.of_groups(groups, self.length)

    def _spaced(self) -> list[Chosen]:
        """The newest frames, with the spacing that their motion asks for."""
        spacing, _ = motion_spacing(np.stack([small for _, _, small in self._newest]))
        return [(number, frame, spacing) for number, frame, _ in self._newest]


def _change(one: Array, other: Array) -> float:
    return float(np.abs(one - other).mean())
