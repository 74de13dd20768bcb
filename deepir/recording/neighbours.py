"""Runs of neighbouring frames of a recording, kept while it is read once."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]

#: Of a run: two frames and their successors, four frames apart: a camera that shakes moves otherwise by then.
OFFSETS = (0, 1, 4, 5)
LENGTH = OFFSETS[-1] + 1
MAX_RUNS = 12  # that are kept, at most


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
