"""A simulated recording and its truth."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from deepir.simulate.detector import expose, fixed_pattern
from deepir.simulate.files import save_with_truth
from deepir.simulate.recording.camera import (
    automatic_gain,
    compress,
    drifting_offsets,
    lagged_frames,
    shutter_closures,
)
from deepir.simulate.recording.paths import CameraPath, camera_path
from deepir.simulate.recording.settings import RecordingSettings
from deepir.simulate.recording.surfaces import World, render_view
from deepir.simulate.recording.worlds import world

DEFAULT_RECORDING = RecordingSettings()


@dataclass(frozen=True)
class RecordingTruth:
    """Everything that made a recording, counts: `agc_gain (gain scene + offset + noise) + agc_offset`."""

    #: What pixels without pattern and noise would show of each frame, pedestal and lag included.
    scene: np.ndarray  # (N, H, W), float32
    gain: np.ndarray  # (H, W), mean one over good pixels
    offset: np.ndarray  # (N, H, W), float32, mean zero over good pixels
    shutter: np.ndarray  # (N,) bool: frames of the closed shutter
    agc_gain: np.ndarray  # (N,), grey levels per count; one without an automatic gain control
    agc_offset: np.ndarray  # (N,), grey levels
    bad_pixels: np.ndarray  # (H, W) bool
    moving: np.ndarray  # (N, H, W) bool: samples that cars and people cover
    noise: float  # sigma of a sample before the gain control, counts, rounding included
    position: np.ndarray  # (N, 3), of the camera, m: right, down and ahead; the ground is at zero
    rotation: np.ndarray  # (N, 3, 3), from the camera's axes to the world's
    focal: float  # focal length, px


@dataclass(frozen=True)
class Recording:
    """Frames (N, H, W), uint16 counts or uint8 grey levels, their times, and their truth."""

    frames: np.ndarray
    times: np.ndarray  # (N,), s
    truth: RecordingTruth
    settings: RecordingSettings
    seed: int

    def save(self, path: str | Path) -> tuple[Path, Path]:
        """Write `path` (frames, times; settings as JSON) and, beside it, STEM_truth.npz (the fields of the truth).

        Raises:
            DataError: The name does not end in .npz.
        """
        settings = {"seed": self.seed, **asdict(self.settings)}
        return save_with_truth(Path(path), self.truth, settings, frames=self.frames, times=self.times)


def simulate_recording(settings: RecordingSettings = DEFAULT_RECORDING, *, seed: int = 0) -> Recording:
    """Record a world through which a camera moves.

    Path, world, pattern, drift and noise have independent random streams: another noise leaves the path unchanged.

    Args:
        settings: The camera, its motion, and how frames are stored.
        seed: The same seed gives the same recording.

    Raises:
        DataError: Frames are to be compressed, and PyAV is not installed.
    """
    path_rng, world_rng, pattern_rng, shading_rng, drift_rng, noise_rng = np.random.default_rng(seed).spawn(6)
    path = camera_path(settings, path_rng)
    closed = shutter_closures(settings)
    moving = np.zeros((settings.n_frames, *settings.shape), bool)
    flux = _flux(world(settings, seed, world_rng), path, closed, moving, settings)
    scene = np.stack(list(lagged_frames(flux, settings)))

    sensor = settings.sensor()
    gain, offset, defects = fixed_pattern(sensor, pattern_rng, shading_rng)
    good = defects == 0
    gain, offset = gain / gain[good].mean(), offset - offset[good].mean()
    offset = drifting_offsets(settings, gain, offset, closed, drift_rng)
    offset -= offset[:, good].mean(1)[:, None, None]
    frames = np.concatenate([
        expose(scene[k : k + 1], gain, offset[k], np.zeros(1), defects, sensor, noise_rng, noise_rng)
        for k in range(settings.n_frames)
    ])  # fmt: skip
    agc_gain, agc_offset = np.ones(settings.n_frames), np.zeros(settings.n_frames)
    if settings.agc:
        frames, agc_gain, agc_offset = automatic_gain(frames, closed, good, settings)
    if settings.compression != "none":
        frames = compress(frames, settings)
    each = slice(None, None, settings.substeps)
    truth = RecordingTruth(
        scene=scene,
        gain=gain,
        offset=offset,
        shutter=closed,
        agc_gain=agc_gain,
        agc_offset=agc_offset,
        bad_pixels=~good,
        moving=moving,
        noise=float(np.hypot(settings.read_noise * settings.contrast, np.sqrt(1 / 12))),
        position=path.position[each],
        rotation=path.rotation[each],
        focal=settings.focal,
    )
    return Recording(frames, path.times[each], truth, settings, seed)


def _flux(
    seen: World, path: CameraPath, closed: np.ndarray, moving: np.ndarray, settings: RecordingSettings
) -> Iterator[np.ndarray]:
    """Flux on the pixels at each instant, counts; fills `moving` of each frame."""
    for k, time in enumerate(path.times):
        frame, first = divmod(k, settings.substeps)
        # The instants between two frames belong to the later one.
        if closed[frame + (first > 0)]:
            yield np.full(settings.shape, settings.flat, np.float32)
            continue
        values, moves = render_view(
            seen, path.position[k], path.rotation[k], settings.focal, settings.shape, settings.psf_sigma, time
        )
        if first == 0:
            moving[frame] = moves
        yield np.float32(settings.pedestal) + np.float32(settings.contrast) * values
