"""Correct a whole recording: read it once for the sensor, and once more for the corrected frames."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deepir.calibration import CorrectionMaps
from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import stream_frames, write_npz
from deepir.recording.estimate import AUTO, SensorEstimate, estimate_sensor
from deepir.recording.keyframes import Keyframes, choose_keyframes

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class CorrectedRecording:
    """A recording and the estimate of its sensor; iterating gives corrected frames (h, w), float32.

    Attributes:
        read: Reads the recorded frames from the start.
        estimate: Of the sensor, from the keyframes.
        keyframes: That it was estimated from.
    """

    read: Callable[[], Iterator[Array]]
    estimate: SensorEstimate
    keyframes: Keyframes

    def __len__(self) -> int:
        return self.keyframes.length

    def __iter__(self) -> Iterator[Array]:
        return map(self.correct, self.read())

    @property
    def frames(self) -> Array:
        """All corrected frames, (N, h, w), float32."""
        return np.stack(list(self))

    @functools.cached_property
    def maps(self) -> CorrectionMaps:
        """Gain, offset and bad pixels, as `deepir apply` takes them: frame = gain scene + offset."""
        found = self.estimate
        return CorrectionMaps(found.gain, found.offset + found.level * (1 - found.gain), found.bad_pixels)

    def correct(self, frame: Array) -> Array:
        """Correct a frame (h, w) of this camera, in the recording's units."""
        found = self.estimate
        if found.strength is not None:
            values = np.ma.filled(frame.astype(np.float32), np.nan)
            frame = values - np.float32(found.strength(values) - 1) * found.offset
        return self.maps.correct(frame)

    def save_maps(self, path: str | os.PathLike[str]) -> None:
        """Write gain, offset, bad pixels, and how well each correction serves held-out frames, to an `.npz`."""
        write_npz(
            path,
            {
                "gain": self.maps.gain.astype(np.float32),
                "offset": self.maps.offset.astype(np.float32),
                "bad_pixels": self.maps.bad_pixels,
                "level": np.array(self.estimate.level),
                "correction": np.array(self.estimate.kept),
                **{f"nats_{name}": np.asarray(value) for name, value in self.estimate.nats.items()},
            },
        )


def correct(
    recording: str | os.PathLike[str] | Array,
    *,
    key: str | None = None,
    raw: Raw | None = None,
    correction: str = AUTO,
) -> CorrectedRecording:
    """Correct a recording of a moving camera: `correct("drive.avi").frames`.

    Args:
        recording: A file, folder or glob of any length, or frames (N, h, w).
        key: Name of the array in a file that holds several.
        raw: Layout of a file without a header.
        correction: What is corrected, one of `CORRECTIONS`; "auto": what serves held-out frames best.

    Raises:
        DataError: It cannot be read, has few frames, or the camera stands still.
    """
    if isinstance(recording, np.ndarray):
        if recording.ndim != 3 or not len(recording):
            raise DataError(f"frames of shape {recording.shape}; expected (frames, height, width)")
        read: Callable[[], Iterator[Array]] = functools.partial(iter, recording)
    else:
        read = functools.partial(stream_frames, Path(recording), key=key, raw=raw)
    keyframes = choose_keyframes(read())
    return CorrectedRecording(read, estimate_sensor(keyframes, correction), keyframes)
