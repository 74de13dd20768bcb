"""A simulated recording and its truth."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import import_optional
from deepir.simulate.burst import Simulated
from deepir.simulate.detector import expose, fixed_pattern, lagged, sensor_parts
from deepir.simulate.paths import CameraPath, camera_path
from deepir.simulate.planes import World, render_view
from deepir.simulate.settings import RecordingSettings
from deepir.simulate.worlds import world

__all__ = ["Recording", "RecordingSettings", "RecordingTruth", "residual_map", "residual_pattern", "simulate_recording"]

CLOSURE_DURATION = 0.1  # s that the shutter stays closed
AGC_TIME_CONSTANT = 0.5  # s; time constant of the automatic gain control
AGC_PERCENTILES = (1.0, 99.0)  # percentiles of a frame that are mapped to AGC_LEVELS
AGC_LEVELS = (16.0, 240.0)  # grey levels of these percentiles
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
class Recording(Simulated):
    """Frames (N, H, W), uint16 counts or uint8 grey levels, their times, and their truth."""

    truth: RecordingTruth
    settings: RecordingSettings
    times: np.ndarray  # (N,), s


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
    if settings.tau_ms:
        flux = lagged(flux, 1000 / (settings.frame_rate * settings.substeps) / settings.tau_ms)
    scene = np.stack(list(islice(flux, 0, None, settings.substeps)))

    gain, offset, defects = fixed_pattern(settings, pattern_rng, shading_rng)
    good = defects == 0
    gain, offset = gain / gain[good].mean(), offset - offset[good].mean()
    offset = drifting_offsets(settings, gain, offset, closed, drift_rng)
    offset -= offset[:, good].mean(1)[:, None, None]
    frames = np.concatenate([
        expose(scene[k : k + 1], gain, offset[k], np.zeros(1), defects, settings, noise_rng, noise_rng)
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
    return Recording(frames, truth, settings, seed, path.times[each])


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


def shutter_closures(settings: RecordingSettings) -> np.ndarray:
    """Frames (N,) bool of the closed shutter; one closure was just before the recording."""
    if not settings.shutter_every:
        return np.zeros(settings.n_frames, bool)
    frame = np.arange(settings.n_frames)
    every = max(2, round(settings.shutter_every * settings.frame_rate))
    lasts = min(max(1, round(CLOSURE_DURATION * settings.frame_rate)), every - 1)
    return np.asarray((frame >= every) & (frame % every < lasts))


def drifting_offsets(
    settings: RecordingSettings, gain: np.ndarray, offset: np.ndarray, closed: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """The offset of each frame (N, H, W), counts, from the first `offset` (H, W) of a recording without a shutter.

    Pixels, columns and rows drift by independent steps in the proportions of their sigmas. With a shutter, the camera
    subtracts its picture: `(1 - gain) flat` and a residual remain after each closure, of frames `closed` (N,).
    """
    parts = np.array([settings.offset_pixel, settings.offset_column, settings.offset_row])
    parts = parts / np.linalg.norm(parts) if parts.any() else np.array([1.0, 0.0, 0.0])
    passed = 1 / settings.frame_rate
    kept, variance = 1.0, passed
    if settings.drift_time:
        kept = np.exp(-passed / settings.drift_time)
        variance = settings.drift_time * (1 - kept**2) / 2
    size = settings.contrast * settings.drift * np.sqrt(variance)

    offsets = ("offset_pixel", "offset_column", "offset_row", "shading")
    left = dataclasses.replace(settings, **{key: settings.shutter_residual * getattr(settings, key) for key in offsets})

    def after_closure() -> np.ndarray:
        residual = fixed_pattern(left, rng, rng)[1]
        return (1 - gain) * settings.flat + residual - residual.mean()

    base = after_closure() if settings.shutter_every else offset
    drift, found = np.zeros(settings.shape), np.empty((settings.n_frames, *settings.shape), np.float32)
    for k in range(settings.n_frames):
        if k and closed[k - 1] and not closed[k]:
            base, drift = after_closure(), np.zeros(settings.shape)
        found[k] = base + drift
        if size:
            steps = sensor_parts(settings.shape, rng.standard_normal)
            drift = kept * drift + size * sum(s * step for s, step in zip(parts, steps, strict=True))
    return found


def automatic_gain(
    raw: np.ndarray, closed: np.ndarray, good: np.ndarray, settings: RecordingSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """8-bit frames of an automatic gain control, and the gain (N,) and offset (N,) that map counts to grey levels.

    It follows the contrast of the good pixels (H, W) slowly, and holds while the shutter is `closed` (N,).
    """
    kept = np.exp(-1 / (settings.frame_rate * AGC_TIME_CONSTANT))
    ends, state = np.empty((len(raw), 2)), None
    for k, frame in enumerate(raw):
        if state is None or not closed[k]:
            now = np.percentile(frame[good], AGC_PERCENTILES)
            state = now if state is None else kept * state + (1 - kept) * now
        ends[k] = state
    gain = (AGC_LEVELS[1] - AGC_LEVELS[0]) / np.maximum(ends[:, 1] - ends[:, 0], 1.0)
    offset = AGC_LEVELS[0] - gain * ends[:, 0]
    frames = np.empty(raw.shape, np.uint8)
    for k, frame in enumerate(raw):
        frames[k] = np.clip(np.rint(gain[k] * frame + offset[k]), 0, 255)
    return frames, gain, offset


def compress(frames: np.ndarray, settings: RecordingSettings) -> np.ndarray:
    """Frames (N, H, W), uint8, after a lossy codec, with their grey as its luminance, in the full range.

    Raises:
        DataError: PyAV is not installed.
    """
    av = import_optional("av", "video", f"recording.compression = {settings.compression}")
    count, height, width = frames.shape
    padded = np.pad(frames, ((0, 0), (0, height % 2), (0, width % 2)), mode="edge")
    rows, columns = padded.shape[1:]
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as film:
        rate = max(1, round(settings.frame_rate))
        track = film.add_stream(settings.compression if settings.compression != "h264" else "libx264", rate=rate)
        track.width, track.height, track.pix_fmt = columns, rows, "yuv420p"
        track.bit_rate = int(settings.bits_per_pixel * rows * columns * rate)
        track.codec_context.bit_rate_tolerance = track.bit_rate
        track.codec_context.thread_count = 1
        for frame in padded:
            colours = np.full((rows // 2, columns), 128, np.uint8)
            film.mux(track.encode(av.VideoFrame.from_ndarray(np.concatenate([frame, colours]), format="yuv420p")))
        film.mux(track.encode())
    file.seek(0)
    with av.open(file) as film:
        found = [each.to_ndarray(format="yuv420p")[:height, :width] for each in film.decode(video=0)]
    return np.stack(found[:count])


def residual_pattern(corrected: np.ndarray, recording: Recording) -> float:
    """Root mean square over good pixels of `residual_map`.

    Args:
        corrected: (N, H, W), in the units of the recording's frames.
        recording: With its truth.

    Returns:
        In sigmas of the noise of a sample (`truth.noise`).

    Raises:
        DataError: The shapes differ, or all frames are of the shutter.
    """
    return float(np.sqrt(np.nanmean(residual_map(corrected, recording) ** 2)))


def residual_map(corrected: np.ndarray, recording: Recording) -> np.ndarray:
    """Temporal mean of the error of a correction.

    The level of each frame is free and, with an automatic gain control, its gain too: both by least squares. Bad
    pixels, frames of the shutter, and samples at an end of 8 bits are left out.

    Args:
        corrected: (N, H, W), in the units of the recording's frames.
        recording: With its truth.

    Returns:
        (H, W), in sigmas of the noise of a sample (`truth.noise`), mean zero; NaN without a sample.

    Raises:
        DataError: The shapes differ, or all frames are of the shutter.
    """
    truth = recording.truth
    if corrected.shape != recording.frames.shape:
        raise DataError(f"corrected: frames of {recording.frames.shape} are needed, not of {corrected.shape}")
    if truth.shutter.all():
        raise DataError("recording: all frames are of the shutter")
    total, count = np.zeros((2, *truth.gain.shape))
    for k in np.flatnonzero(~truth.shutter):
        valid = ~truth.bad_pixels
        if recording.settings.agc:
            valid = valid & (recording.frames[k] > 0) & (recording.frames[k] < 255)
        frame, scene = corrected[k].astype(float), truth.scene[k].astype(float)
        gain = 1.0
        if recording.settings.agc:
            from_mean = scene[valid] - scene[valid].mean()
            gain = float(from_mean @ frame[valid] / (from_mean @ from_mean))
        error = frame / gain - scene
        total[valid] += error[valid] - error[valid].mean()
        count[valid] += 1
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return np.asarray((mean - np.nanmean(mean)) / truth.noise)
