"""A simulated camera without end: a recording played forth and back, with drift, closures of the shutter, and stops."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepir.simulate.recording import RecordingSettings, simulate_recording

Array = np.ndarray[Any, Any]

CLOSED = 0.5  # s that a closure of the shutter takes
RESIDUAL = 0.1  # share of the offset that is left after a closure
NOISE_FRAMES = 8  # drawn once, and shifted at random


@dataclass(frozen=True)
class Moment:
    """A frame and its truth, counts.

    Attributes:
        time: s.
        frame: (h, w), uint16.
        scene: (h, w).
        clean: (h, w), the frame without noise.
        closed: whether it shows the shutter.
    """

    time: float
    frame: Array
    scene: Array
    clean: Array
    closed: bool


class Stream:
    """Frames of a moving camera.

    Args:
        settings: of the recording that is played.
        seed: of world, pattern and noise.
        drift: rms change of the offset in the first second, fraction of the range; it grows with the root of the time.
        closures: s between closures of the shutter; 0: none.
        moving, standing: s that the camera moves, and then stands still, again and again.
    """

    def __init__(
        self,
        settings: RecordingSettings,
        seed: int,
        *,
        drift: float = 0.0,
        closures: float = 0.0,
        moving: float = np.inf,
        standing: float = 0.0,
    ) -> None:
        recording = simulate_recording(settings, seed=seed)
        self.rate, self.closures = settings.frame_rate, closures
        self.moving, self.standing = moving, standing
        self.scene, self.gain = recording.truth.scene, recording.truth.gain.astype(np.float32)
        self.good, self.noise = ~recording.truth.bad_pixels, recording.truth.noise
        self.offset, self.flat = recording.truth.offset[0], settings.flat
        self.stuck = recording.frames[0]
        self.rng = np.random.default_rng(seed + 1)
        change = self.rng.permutation(self.offset.ravel()).reshape(self.offset.shape)
        self.drift = drift * settings.contrast / change.std() * change
        self.noises = self.rng.normal(0, self.noise, (NOISE_FRAMES, *self.gain.shape)).astype(np.float32)

    def moments(self, seconds: float) -> Iterator[Moment]:
        """So many seconds of it."""
        residual, closure = self.offset, 0
        for k in range(round(seconds * self.rate)):
            time = k / self.rate
            scene = self.scene[self._place(time)]
            since, closed = time, False
            offset = self.offset
            if self.closures and time >= self.closures:
                number, since = divmod(time, self.closures)
                closed = since < CLOSED
                if number != closure:  # another pattern, and a weaker one
                    closure = int(number)
                    residual = RESIDUAL * np.roll(self.offset, (7 * closure, 11 * closure), (0, 1))
                offset = residual
            shown = np.full_like(scene, self.flat) if closed else scene
            clean = (self.gain * shown + offset + np.float32(since**0.5) * self.drift).astype(np.float32)
            noise = self.noises[k % NOISE_FRAMES]
            noisy = clean + np.roll(noise, int(self.rng.integers(noise.size)))
            frame = np.where(self.good, noisy.round().clip(0, 65535), self.stuck).astype(np.uint16)
            yield Moment(time, frame, scene, clean, closed)

    def left(self, moment: Moment, gain: Array | float, offset: Array) -> float:
        """Deviation of the pattern that a correction leaves, in sigmas of the noise of a sample."""
        error = ((moment.clean - offset) / gain - moment.scene)[self.good]
        return float(error.std() / self.noise)

    def _place(self, time: float) -> int:
        """Number of the recording's frame: it is played forth and back, and waits while the camera stands."""
        if np.isfinite(self.moving):
            times, rest = divmod(time, self.moving + self.standing)
            time = times * self.moving + min(rest, self.moving)
        last = len(self.scene) - 1
        place = round(time * self.rate) % (2 * last)
        return int(min(place, 2 * last - place))
