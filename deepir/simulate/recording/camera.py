"""The camera of a recording: lag, drift, shutter, gain control and compression."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator

import numpy as np

from deepir.io.guards import import_optional
from deepir.simulate.detector import fixed_pattern, lag_coefficients
from deepir.simulate.recording.settings import RecordingSettings

CLOSURE_DURATION = 0.1  # s that the shutter stays closed
AGC_TIME_CONSTANT = 0.5  # s; time constant of the automatic gain control
AGC_PERCENTILES = (1.0, 99.0)  # percentiles of a frame that are mapped to AGC_LEVELS
AGC_LEVELS = (16.0, 240.0)  # grey levels of these percentiles


def shutter_closures(settings: RecordingSettings) -> np.ndarray:
    """Frames (N,) bool of the closed shutter; one closure was just before the recording."""
    if not settings.shutter_every:
        return np.zeros(settings.n_frames, bool)
    frame = np.arange(settings.n_frames)
    every = max(2, round(settings.shutter_every * settings.frame_rate))
    lasts = min(max(1, round(CLOSURE_DURATION * settings.frame_rate)), every - 1)
    return np.asarray((frame >= every) & (frame % every < lasts))


def drifting_offsets(
    settings: RecordingSettings,
    gain: np.ndarray,
    offset: np.ndarray,
    closed: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """The offset of each frame, counts.

    Pixels, columns and rows drift by independent steps in the proportions of their sigmas. With a shutter, the camera
    subtracts its picture: `(1 - gain) flat` and a residual remain after each closure.

    Args:
        settings: Drift and shutter.
        gain: (H, W), mean one.
        offset: (H, W), at the start of a recording without a shutter.
        closed: (N,) bool, frames of the closed shutter.
        rng: Random stream of drift and residuals.

    Returns:
        (N, H, W), float32.
    """
    parts = np.array([settings.offset_pixel, settings.offset_column, settings.offset_row])
    parts = parts / np.linalg.norm(parts) if parts.any() else np.array([1.0, 0.0, 0.0])
    height, width = settings.shape
    passed = 1 / settings.frame_rate
    kept, variance = 1.0, passed
    if settings.drift_time:
        kept = np.exp(-passed / settings.drift_time)
        variance = settings.drift_time * (1 - kept**2) / 2
    size = settings.contrast * settings.drift * np.sqrt(variance)

    def after_closure() -> np.ndarray:
        residual = fixed_pattern(settings.sensor(settings.shutter_residual), rng, rng)[1]
        return (1 - gain) * settings.flat + residual - residual.mean()

    base = after_closure() if settings.shutter_every else offset
    drift, found = np.zeros((height, width)), np.empty((settings.n_frames, height, width), np.float32)
    for k in range(settings.n_frames):
        if k and closed[k - 1] and not closed[k]:
            base, drift = after_closure(), np.zeros((height, width))
        found[k] = base + drift
        if size:
            steps = (
                s * rng.standard_normal(n)
                for s, n in zip(parts, ((height, width), (1, width), (height, 1)), strict=True)
            )
            drift = kept * drift + size * sum(steps)
    return found


def lagged_frames(flux: Iterable[np.ndarray], settings: RecordingSettings) -> Iterator[np.ndarray]:
    """Frames of pixels with the time constant `tau_ms`, from the flux (H, W) at successive instants.

    Exact for a flux that is linear between two instants. Before the first instant the pixels have settled.
    """
    kept, old, new = 0.0, 0.0, 1.0
    if settings.tau_ms:
        kept, old, new = lag_coefficients(1000 / (settings.frame_rate * settings.substeps) / settings.tau_ms)
    instants = iter(flux)
    shown = before = next(instants)
    yield shown
    for k, now in enumerate(instants, 1):
        shown, before = kept * shown + old * before + new * now, now
        if k % settings.substeps == 0:
            yield shown


def automatic_gain(
    raw: np.ndarray, closed: np.ndarray, good: np.ndarray, settings: RecordingSettings
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """8-bit frames of an automatic gain control, which follows the contrast slowly and ignores the shutter.

    Args:
        raw: (N, H, W), counts.
        closed: (N,) bool, frames of the closed shutter.
        good: (H, W) bool, pixels that the control uses.
        settings: Frame rate.

    Returns:
        Frames (N, H, W), uint8, and the gain (N,) and offset (N,) that map counts to grey levels.
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
    """Frames after a lossy codec, with their grey as its luminance, in the full range.

    Args:
        frames: (N, H, W), uint8.
        settings: Codec and bit rate.

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
        track = film.add_stream(
            settings.compression if settings.compression != "h264" else "libx264", rate=rate
        )
        track.width, track.height, track.pix_fmt = columns, rows, "yuv420p"
        track.bit_rate = int(settings.bits_per_pixel * rows * columns * rate)
        track.codec_context.bit_rate_tolerance = track.bit_rate
        track.codec_context.thread_count = 1
        for frame in padded:
            colours = np.full((rows // 2, columns), 128, np.uint8)
            film.mux(
                track.encode(av.VideoFrame.from_ndarray(np.concatenate([frame, colours]), format="yuv420p"))
            )
        film.mux(track.encode())
    file.seek(0)
    with av.open(file) as film:
        found = [each.to_ndarray(format="yuv420p")[:height, :width] for each in film.decode(video=0)]
    return np.stack(found[:count])
