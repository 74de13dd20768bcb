"""What online methods share: they process a video frame by frame and keep a weight and a bias per pixel."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TypeVar

import numpy as np

from deepir.baselines.average import Array

State = TypeVar("State")

#: Limits of the training input, in ranges of the frames; stuck pixels beyond them would diverge.
INPUT_LIMITS = (-1.0, 2.0)


def normalise(frames: Array) -> tuple[Array, float, float]:
    """Frames in the unit of the step sizes.

    Args:
        frames: (N, h, w), in the data's units.

    Returns:
        Frames from about zero to about one, their lowest value and their range, in the data's units.
    """
    low, high = np.percentile(frames, [0.1, 99.9])
    span = float(high - low) or 1.0
    return (frames.astype(np.float64) - low) / span, float(low), span


def frame_sequence(n_frames: int, passes: int) -> Iterator[int]:
    """Frame numbers of a burst played forth and back `passes` times.

    >>> list(frame_sequence(3, 3))
    [0, 1, 2, 1, 0, 1, 2]
    """
    yield 0
    for k in range(passes):
        yield from range(1, n_frames) if k % 2 == 0 else range(n_frames - 2, -1, -1)


def last_of(states: Iterator[State]) -> State:
    """The state of an online method after all frames."""
    return deque(states, maxlen=1).pop()


def gain_and_offset(weight: Array, bias: Array, low: float, span: float) -> tuple[Array, Array]:
    """Gain and offset (h, w) of pixels that are corrected by `weight * (y - low) / span + bias`."""
    gain = 1 / weight.clip(min=1e-3)
    return gain, low - gain * (low + span * bias)
