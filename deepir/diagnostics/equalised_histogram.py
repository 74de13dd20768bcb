"""Detect frames with an equalised histogram."""

from __future__ import annotations

import numpy as np

from deepir.io.inspection.display_range import Array
from deepir.messages import Message

#: Largest distance of the cumulative histogram from a uniform one; 0.13 and more in frames that are not equalised.
MAX_DISTANCE_FROM_UNIFORM = 0.01


def is_equalised(frames: Array) -> bool:
    """Whether the histogram of every frame is uniform; frames (N, h, w), NaN where unknown."""
    for frame in frames:
        values, counts = np.unique(frame[np.isfinite(frame)], return_counts=True)
        if len(values) < 3:
            return False
        below = counts[1:].cumsum() / counts[1:].sum()
        if (
            np.abs(below - (values[1:] - values[0]) / (values[-1] - values[0])).max()
            > MAX_DISTANCE_FROM_UNIFORM
        ):
            return False
    return True


def equalised_message(frames: Array) -> list[str]:
    """Warning for equalised frames (N, h, w), NaN where unknown; [] otherwise."""
    if not is_equalised(frames):
        return []
    return [
        Message(
            "equalised-frames",
            "each frame's histogram is equalised: its values are ranks, not flux, so that neither gain and offset nor "
            "the scene's contrasts mean much. Record the raw (radiometric) stream of 14 or 16 bits, or a linear gain",
        )
    ]
