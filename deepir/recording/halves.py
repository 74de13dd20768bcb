"""Two estimates of the fine offset, from the odd and from the even groups of keyframes.

Where they agree it is the sensor's, or what the scenes of both have in common.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from deepir.recording.consensus import gradient_consensus
from deepir.recording.estimate import SensorEstimate
from deepir.recording.keyframes import Keyframes
from deepir.recording.offset import fine_offset

Array = np.ndarray[Any, Any]

MIN_FRAMES, MAX_FRAMES = 4, 16  # of a half


def half_offsets(keyframes: Keyframes, estimate: SensorEstimate) -> Array | None:
    """Fine offsets (2, h, w) of the odd and of the even groups.

    Args:
        keyframes: that the sensor was estimated from.
        estimate: of the sensor; its gain and the strengths of its pattern are taken as known.

    Returns:
        In the frames' units; None where a half has too few frames.
    """
    some, _ = keyframes.split()
    _, order = np.unique(some.groups, return_inverse=True)
    halves = [some.frames[order % 2 == k] for k in (0, 1)]
    if min(map(len, halves)) < MIN_FRAMES:
        return None
    return np.stack([_fine_offset(half[:: -(-len(half) // MAX_FRAMES)], estimate) for half in halves])


def _fine_offset(frames: Array, estimate: SensorEstimate) -> Array:
    usable = np.isfinite(frames)
    frames = np.where(usable, frames - np.float32(estimate.level), 0)
    if estimate.strength is not None:
        strengths = [estimate.strength(frame) for frame in frames]
        frames /= np.array(strengths, np.float32)[:, None, None]
    frames /= estimate.gain.astype(np.float32)
    return estimate.gain * fine_offset(gradient_consensus(frames, usable), ~estimate.bad_pixels)
