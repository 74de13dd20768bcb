"""The frames of a recording that show one scene, registered, from which its sensor is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage

from deepir.errors import DataError
from deepir.recording.alignment import REFINE_SIGMA, TURN, Links, Spectrum, refined_motion
from deepir.recording.burst import Burst
from deepir.recording.canvas import Canvas, centred, project
from deepir.recording.consensus import gradient_consensus
from deepir.recording.defective_pixels import noise_deviation

Array = np.ndarray[Any, Any]

CANDIDATES = 48  # frames that are registered to a reference, at most
FRAMES = 24  # of a burst, at most
MIN_LIKENESS = 0.4  # correlation with the frames that it is registered to, of a frame that is used
MAX_REACH = 0.5  # of the sides: how far a frame of a burst is from the reference
#: Squared tangents of half a camera's field of view that are tried, from a telephoto lens to 80 degrees.
CURVATURES = (0.0, 0.06, 0.12, 0.2, 0.35, 0.7)
#: Upper quartile of the changes between two frames, in sigmas of the noise of a change, below which nothing has moved:
#: 1.15 for noise alone.
REST_SIGMAS = 1.2
SAMPLE_STRIDE = 3  # px, between samples that are compared
TRIAL_FRAMES = 8  # of a burst, that curvatures are tried on
MIN_FRAMES = 4  # of a burst
MIN_STEP = 0.5  # px: frames that moved by less since another one add nothing but an average
AT_REST = (
    "the camera stands still in most of the recording, or sees nothing but a uniform wall, so that scene and fixed "
    "pattern cannot be separated. Move the camera over something with edges, or apply maps of another recording: "
    "deepir apply MAPS FILE"
)


class CameraAtRestError(DataError):
    """The camera stands still."""


@dataclass(frozen=True)
class _Scene:
    """Frames that show one scene: their numbers, links, those of them that are chosen, and the reference's place."""

    numbers: Array
    links: Links
    chosen: Array
    reference: int

    @classmethod
    def about(cls, frames: Array, around: int, pattern: Array) -> _Scene | None:
        """Frames (N, h, w) like the one of number `around`, less a pattern; None where too few are.

        Raises:
            CameraAtRestError: Most frames show the same at the same place.
        """
        step = -(-len(frames) // CANDIDATES)
        numbers, size = np.arange(around % step, len(frames), step), (frames.shape[1], frames.shape[2])
        reference = int(np.flatnonzero(numbers == around)[0])
        links = Links.of([Spectrum.of(frames[k] - pattern) for k in numbers], reference)
        motion = links.motion(0.0, max(size) / 2)
        stays = _stays(frames[numbers], reference, noise_deviation(frames - pattern))
        if stays.mean() > 0.5:
            raise CameraAtRestError(AT_REST)
        motion[stays] = np.eye(3)
        near = (np.abs(motion[:, :2, 2]) < MAX_REACH * np.array(size[::-1])).all(1)
        alike = (links.likeness >= MIN_LIKENESS) & near
        chosen = _apart(motion, alike, reference, size)
        if len(chosen) >= MIN_FRAMES:
            return cls(numbers, links, chosen, int(np.flatnonzero(chosen == reference)[0]))
        if alike.sum() >= max(MIN_FRAMES, len(numbers) / 2):
            raise CameraAtRestError(AT_REST)
        return None


def find_burst(
    frames: Array, usable: Array, around: int, start: Array, *, gains_differ: bool
) -> tuple[Burst, Array, Array] | None:
    """Frames that show the scene of a reference, as far apart as they are; None where too few do.

    Args:
        frames: (N, h, w), float32.
        usable: same shape, bool.
        around: number of the reference.
        start: (h, w), a pattern that is taken off before frames are compared.
        gains_differ: whether an automatic gain control may change the frames' gains.

    Returns:
        The burst, the numbers of its frames, and the pattern (h, w) that they share.

    Raises:
        CameraAtRestError: Most frames show the same at the same place.
    """
    first = _Scene.about(frames, around, start.astype(np.float32))
    if first is None:
        return None
    some = first.numbers[first.chosen]
    pattern = shared_pattern(frames[some], usable[some])
    scene = _Scene.about(frames, around, pattern) or first
    kept, half = scene.numbers[scene.chosen], max(frames.shape[1:]) / 2
    known, detail = usable[kept].astype(np.float32), frames[kept] - pattern
    few = np.unique(np.append(np.arange(0, len(kept), -(-len(kept) // TRIAL_FRAMES)), scene.reference))
    trials = []
    for each in CURVATURES:
        motion = scene.links.motion(each, half)[scene.chosen][few]
        trials.append(
            _misfit(detail[few], known[few], motion, int(np.searchsorted(few, scene.reference)), each)
        )
    curvature = CURVATURES[int(np.argmin(trials))]
    burst = Burst(
        frames[kept],
        usable[kept],
        scene.links.motion(curvature, half)[scene.chosen],
        scene.reference,
        curvature=curvature,
        gains_differ=gains_differ,
    )
    return burst, kept, pattern


def _stays(frames: Array, reference: int, noise: float) -> Array:
    """Whether each frame (n, h, w) differs from a reference by little but noise and level, (n,) bool."""
    change = (frames - frames[reference])[:, ::SAMPLE_STRIDE, ::SAMPLE_STRIDE].reshape(len(frames), -1)
    change = np.abs(change - np.median(change, axis=1, keepdims=True))
    return np.asarray(np.quantile(change, 0.75, axis=1) < REST_SIGMAS * 2**0.5 * noise)


def _misfit(frames: Array, known: Array, motion: Array, reference: int, curvature: float) -> float:
    """Mean misfit of frames to their mean scene, once their motion is refined; inf where that is far off."""
    size = (frames.shape[1], frames.shape[2])
    if not _is_near(motion, size):
        return np.inf
    canvas = Canvas(motion, size)
    spread = canvas.spread_weights(known)
    canvas.move(refined_motion(canvas, frames, known, spread, reference, TURN, curvature))
    if not _is_near(canvas.motion, size):
        return np.inf
    weights = canvas.spread_weights(known)
    detail = np.stack([each - ndimage.gaussian_filter(each, REFINE_SIGMA) for each in frames])
    rest = detail - canvas.predicted(canvas.mean(detail, weights))
    return float(np.abs(rest)[canvas.is_seen(weights) & (known > 0)].mean())


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
