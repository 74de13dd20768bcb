"""What frames alone show: an equalised histogram, a shutter that closed between them."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from deepir.arrays.samples import Array
from deepir.arrays.statistics import mixed_difference, subsample
from deepir.messages import Message

#: Largest distance of the cumulative histogram from a uniform one; 0.13 and more in frames that are not equalised.
MAX_DISTANCE_FROM_UNIFORM = 0.01
MAX_SAMPLES = 40_000  # samples of all frames that suffice to find a shutter event
MIN_SAMPLES_PER_FRAME = 200  # fewest samples of a frame
BULK_FRACTION = 0.75  # fraction of the smallest differences that count: the others are edges of the scene
#: Distance between two groups of frames relative to that within them from which their patterns differ.
MIN_SEPARATION = 1.3


def is_equalised(frames: Array) -> bool:
    """Whether the histogram of every frame is uniform; frames (N, h, w), NaN where unknown."""
    for frame in frames:
        values, counts = np.unique(frame[np.isfinite(frame)], return_counts=True)
        if len(values) < 3:
            return False
        below = counts[1:].cumsum() / counts[1:].sum()
        if np.abs(below - (values[1:] - values[0]) / (values[-1] - values[0])).max() > MAX_DISTANCE_FROM_UNIFORM:
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


@torch.no_grad()
def longest_shutter_segment(frames: Tensor, usable: Tensor) -> slice:
    """Longest run of frames with one fixed pattern.

    Mixed differences of frames are mostly pattern and noise. Across a shutter event they differ by more than within
    either part; a camera in motion does not separate frames into such parts.

    Args:
        frames: (N, h, w).
        usable: Samples that count, same shape, bool.

    Returns:
        The frames of the longer part; all of them without an event.
    """
    n, whole = len(frames), slice(0, len(frames))
    if n < 4:
        return whole
    fine, counts = mixed_difference(frames, usable.all(0).expand_as(usable))
    some, known = subsample(fine[:, None], counts[:, None], max_samples=max(MIN_SAMPLES_PER_FRAME, MAX_SAMPLES // n))
    some = some[:, known[0]]
    if not some.numel():
        return whole
    bulk = max(1, int(BULK_FRACTION * some.shape[1]))
    values = some.numpy()
    apart = np.stack([np.partition(np.abs(values - one), bulk - 1)[:, :bulk].mean(1) for one in values])

    def stands_out(at: int) -> float:
        within = max(float(apart[:at, :at].max()), float(apart[at:, at:].max()))
        return float(apart[:at, at:].min()) / max(within, 1e-30)

    at = max(range(2, n - 1), key=stands_out)
    if stands_out(at) < MIN_SEPARATION:
        return whole
    return slice(0, at) if 2 * at >= n else slice(at, n)


def shutter_message(part: slice, n: int) -> list[str]:
    """Warning if only a part of n frames is used; [] otherwise."""
    if part == slice(0, n):
        return []
    at, other = (part.start, f":{part.start}") if part.start else (part.stop, f"{part.stop}:")
    return [
        Message(
            "shutter-in-burst",
            f"the fixed pattern changes between frames {at - 1} and {at}, as where a shutter closes: only frames "
            f"{part.start} to {part.stop - 1} are used. The others: data.frames={other}",
        )
    ]
