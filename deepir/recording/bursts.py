"""The frames of a recording that show one scene, registered, from which its sensor is solved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from deepir.errors import DataError
from deepir.recording.alignment import Spectrum, find_motion
from deepir.recording.canvas import centred, project
from deepir.recording.consensus import gradient_consensus
from deepir.recording.joint_solve import Burst

Array = np.ndarray[Any, Any]

CANDIDATES = 48  # frames that are registered to a reference, at most
FRAMES = 24  # of a burst, at most
MIN_LIKENESS = 0.4  # correlation with the frames that it is registered to, of a frame that is used
MIN_FRAMES = 4  # of a burst
MIN_STEP = 0.5  # px: frames that moved by less since another one add nothing but an average
AT_REST = (
    "the camera stands still in most of the recording, or sees nothing but a uniform wall, so that scene and fixed "
    "pattern cannot be separated. Move the camera over something with edges, or apply maps of another recording: "
    "deepir apply MAPS FILE"
)


class CameraAtRestError(DataError):
    """The camera stands still."""


def find_burst(
    frames: Array, usable: Array, around: int, start: Array, *, gains_differ: bool
) -> tuple[Burst, Array] | None:
    """Frames that show the scene of a reference, as far apart as they are; None where too few do.

    Args:
        frames: (N, h, w), float32.
        usable: same shape, bool.
        around: number of the reference.
        start: (h, w), a pattern that is taken off before frames are compared.
        gains_differ: whether an automatic gain control may change the frames' gains.

    Returns:
        The burst, and the numbers of its frames.

    Raises:
        CameraAtRestError: Most frames show the same at the same place.
    """
    step = -(-len(frames) // CANDIDATES)
    numbers = np.arange(around % step, len(frames), step)
    spectra = [Spectrum.of(frames[k] - start.astype(np.float32)) for k in numbers]
    reference = int(np.flatnonzero(numbers == around)[0])
    motion, likeness = find_motion(spectra, reference)
    alike = likeness >= MIN_LIKENESS
    chosen = _apart(motion, alike, reference, frames.shape[1:])
    if len(chosen) < MIN_FRAMES:
        if alike.sum() >= max(MIN_FRAMES, len(numbers) / 2):
            raise CameraAtRestError(AT_REST)
        return None
    kept = numbers[chosen]
    burst = Burst(
        frames[kept],
        usable[kept],
        motion[chosen],
        int(np.flatnonzero(chosen == reference)[0]),
        gains_differ=gains_differ,
    )
    return burst, kept


def _apart(motion: Array, allowed: Array, reference: int, size: tuple[int, ...]) -> Array:
    """Frames whose motion is far from each other's, the reference first; sorted numbers."""
    y, x = (each[:: size[0] - 1, :: size[1] - 1].ravel() for each in centred(size))
    places = np.stack([np.concatenate(project(each, y, x)) for each in motion]) / len(y) ** 0.5
    chosen = [reference]
    distance = np.where(allowed, np.linalg.norm(places - places[reference], axis=1), 0.0)
    while len(chosen) < FRAMES and distance.max() > MIN_STEP:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return np.sort(chosen)


def burst_motion(motion: Array, factor: int, size: Sequence[int]) -> Array:
    """Motion (n, 3, 3) of frames (h, w), from that of their means over blocks of `factor` px."""
    down, across = ((factor * (side // factor) - side) / 2 for side in size)
    scale = np.array([[factor, 0, across], [0, factor, down], [0, 0, 1.0]])
    return np.asarray(scale @ motion @ np.linalg.inv(scale))


def shared_pattern(frames: Array, usable: Array) -> Array:
    """The pattern that the gradients of frames share, (h, w), float32."""
    level = np.float32(np.median(frames[:, ::4, ::4]))
    return np.asarray(gradient_consensus(np.where(usable, frames, level), usable), np.float32)
