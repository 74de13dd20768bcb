"""Frames corrected one after the other, and how fast."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepir.kernels import memory
from deepir.live.corrector import Corrector, Status
from deepir.live.sources import Paced

Array = np.ndarray[Any, Any]

RATE_OVER = 30  # frames, over which the rate is measured


@dataclass(frozen=True)
class CorrectedFrame:
    """A corrected frame, and the state of its corrector.

    Attributes:
        number: Of the frame, from 1.
        raw: (h, w), as it came.
        corrected: (h, w), float32.
        status: Of the corrector.
        rate: Frames a second.
        delay: Of the correction, s.
        dropped: Frames that came too late, so far.
    """

    number: int
    raw: Array
    corrected: Array
    status: Status
    rate: float
    delay: float
    dropped: int


def play(frames: Iterable[Array], corrector: Corrector) -> Iterator[CorrectedFrame]:
    """Correct frames as they come.

    Args:
        frames: (h, w) each.
        corrector: Of their camera.
    """
    times: deque[float] = deque(maxlen=RATE_OVER + 1)
    with memory.kept():
        for number, frame in enumerate(frames, 1):
            begun = time.perf_counter()
            corrected = corrector(frame)
            now = time.perf_counter()
            times.append(now)
            rate = (len(times) - 1) / (now - times[0]) if len(times) > 1 else 0.0
            dropped = frames.dropped if isinstance(frames, Paced) else 0
            yield CorrectedFrame(number, frame, corrected, corrector.status, rate, now - begun, dropped)
