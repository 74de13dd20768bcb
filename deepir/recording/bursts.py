"""The frames of a recording that show one scene, registered, from which its sensor is solved."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.errors import DataError
from deepir.recording.alignment import REFINE_SIGMA, TURN, Links, Spectrum, refined_motion
from deepir.recording.canvas import Canvas, centred, project
from deepir.recording.consensus import gradient_consensus
from deepir.recording.joint_solve import Burst
from deepir.recording.noise import noise_deviation

Array = np.ndarray[Any, Any]

CANDIDATES = 48  # frames that are registered to a reference, at most
FRAMES = 24  # of a burst, at most
MIN_LIKENESS = 0.4  # correlation with the frames that it is registered to, of a frame that is used
MAX_REACH = 0.5  # of the sides: how far a frame of a burst is from the reference
#: Squared tangents of half a camera's field of view that are tried, from a telephoto lens to 80 degrees.
CURVATURES = (0.0, 0.06, 0.12, 0.2, 0.35, 0.7)
#: Upper quartile of the changes between two frames, in sigmas of the noise of a change, below which nothing has moved.
MIN_CHANGE_SIGMAS = 2.2
SAMPLE_STRIDE = 3  # px, between samples that are compared
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
    links, size = Links.of(spectra, reference), (frames.shape[1], frames.shape[2])
    motion, half = links.motion(0.0, max(size) / 2), max(size) / 2
    motion[_stays(frames[numbers], reference, noise_deviation(frames - start))] = np.eye(3)
    near = (np.abs(motion[:, :2, 2]) < MAX_REACH * np.array(size[::-1])).all(1)
    alike = (links.likeness >= MIN_LIKENESS) & near
    chosen = _apart(motion, alike, reference, size)
    if len(chosen) < MIN_FRAMES:
        if alike.sum() >= max(MIN_FRAMES, len(numbers) / 2):
            raise CameraAtRestError(AT_REST)
        return None
    kept, reference = numbers[chosen], int(np.flatnonzero(chosen == reference)[0])
    known = usable[kept].astype(np.float32)
    trials = [
        _trial(
            frames[kept] - start.astype(np.float32), known, links.motion(each, half)[chosen], reference, each
        )
        for each in CURVATURES
    ]
    _misfit, curvature, motion = min(trials, key=lambda each: each[0])
    burst = Burst(
        frames[kept], usable[kept], motion, reference, curvature=curvature, gains_differ=gains_differ
    )
    return burst, kept


def _stays(frames: Array, reference: int, noise: float) -> Array:
    """Whether each frame (n, h, w) differs from a reference by little but noise and level, (n,) bool."""
    change = (frames - frames[reference])[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE].reshape(len(frames), -1)
    change = np.abs(change - np.median(change, axis=1, keepdims=True))
    return np.asarray(np.quantile(change, 0.75, axis=1) < MIN_CHANGE_SIGMAS * 2**0.5 * noise)


def _trial(
    frames: Array, known: Array, motion: Array, reference: int, curvature: float
) -> tuple[float, float, Array]:
    """Mean misfit of frames to their mean scene, the curvature of their motion, and the motion refined."""
    size = (frames.shape[1], frames.shape[2])
    if not _is_near(motion, size):
        return np.inf, curvature, motion
    canvas = Canvas(motion, size)
    canvas.move(refined_motion(canvas, frames, known, reference, TURN, curvature))
    weights = canvas.spread_weights(known)
    detail = np.stack([each - ndimage.gaussian_filter(each, REFINE_SIGMA) for each in frames])
    rest = detail - canvas.predicted(canvas.mean(detail, weights))
    if not _is_near(canvas.motion, size):
        return np.inf, curvature, motion
    return float(np.abs(rest)[canvas.is_seen(weights) & (known > 0)].mean()), curvature, canvas.motion


def _is_near(motion: Array, size: tuple[int, int]) -> bool:
    """Whether all corners of all frames lie within a side of the reference frame."""
    y, x = (each[:: size[0] - 1, :: size[1] - 1].ravel() for each in centred(size))
    at = np.stack([project(each, y, x) for each in motion])
    return bool((np.abs(at).max((0, 2)) < 1.5 * np.array(size)).all())


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
