"""Correct a whole recording: read it once for the sensor, and once more for the corrected frames."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from deepir.calibration import CorrectionMaps
from deepir.config.components import validate
from deepir.config.schema import Data, Radiometry, Raw
from deepir.errors import ConfigError, DataError
from deepir.io import cropped, stream_data, write_npz
from deepir.io.inspection.axes import oriented
from deepir.recording.estimate import SensorEstimate
from deepir.recording.keyframes import Keyframes, choose_keyframes
from deepir.recording.neighbours import NeighbouringFrames
from deepir.recording.segments import Segment, estimate_segments, segment_at
from deepir.recording.thermal_lag import ThermalLag, thermal_lag

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class CorrectedRecording:
    """A recording and the estimates of its sensor; iterating gives corrected frames (h, w), float32.

    Attributes:
        read: Reads the recorded frames from the start.
        segments: The parts of the recording with one fixed pattern each; most have one.
        keyframes: That the sensor was estimated from.
        neighbours: Runs of frames that thermal lag is estimated from.
    """

    read: Callable[[], Iterator[Array]]
    segments: list[Segment]
    keyframes: Keyframes
    neighbours: NeighbouringFrames

    @classmethod
    def of(
        cls,
        read: Callable[[], Iterator[Array]],
        track: Callable[[Iterator[Array]], Iterator[Array]] = iter,
    ) -> CorrectedRecording:
        """Read a recording once, and estimate its sensor.

        Args:
            read: Reads the recorded frames (h, w) from the start.
            track: Passes frames on while they are read, and shows progress.

        Raises:
            DataError: It has few frames, or the camera stands still.
        """
        neighbours = NeighbouringFrames()
        keyframes = choose_keyframes(neighbours.collect(track(read())))
        return cls(read, estimate_segments(keyframes), keyframes, neighbours)

    def __len__(self) -> int:
        return self.keyframes.length

    def __iter__(self) -> Iterator[Array]:
        return (self.correct(frame, number) for number, frame in enumerate(self.read()))

    @property
    def frames(self) -> Array:
        """All corrected frames, (N, h, w), float32."""
        return np.stack(list(self))

    @property
    def estimate(self) -> SensorEstimate:
        """Of the sensor, as it is at the end of the recording."""
        return next(each.estimate for each in reversed(self.segments) if each.estimate)

    @functools.cached_property
    def maps(self) -> CorrectionMaps:
        """Gain, offset and bad pixels of the same time, as `deepir apply` takes them: frame = gain scene + offset."""
        return next(each.maps for each in reversed(self.segments) if each.estimate)

    @functools.cached_property
    def lag(self) -> ThermalLag | None:
        """Of the pixels; None where too little of the scene is seen at several speeds."""
        runs = zip(self.neighbours.numbers, self.neighbours.runs, strict=True)
        return thermal_lag([np.stack([self.correct(frame, number) for frame in run]) for number, run in runs])

    def correct(self, frame: Array, number: int | None = None) -> Array:
        """Correct a frame (h, w) of this camera, in the recording's units.

        Args:
            frame: Of the recording, or recorded after it.
            number: In the recording; None: after it.
        """
        place = len(self) if number is None else number
        return segment_at(self.segments, place, frame).correct(frame, place)

    def save_maps(self, path: str | os.PathLike[str]) -> None:
        """Write gain, offset and bad pixels, and the offset's standard deviation where it is known, to an `.npz`.

        Where the pattern jumps, `gains` and `offsets` (segments, h, w) and the number of each one's first frame follow.
        """
        parts = [each for each in self.segments if each.estimate]
        over_time = {
            "gains": np.stack([each.maps.gain for each in parts]).astype(np.float32),
            "offsets": np.stack([each.maps.offset for each in parts]).astype(np.float32),
            "first_frames": np.array([each.first for each in parts]),
        }
        deviation = self.estimate.offset_deviation
        write_npz(
            path,
            {
                "gain": self.maps.gain.astype(np.float32),
                "offset": self.maps.offset.astype(np.float32),
                "bad_pixels": self.maps.bad_pixels,
                "level": np.array(self.estimate.level),
                **({} if deviation is None else {"offset_deviation": deviation.astype(np.float32)}),
                **(over_time if len(self.segments) > 1 else {}),
            },
        )


def correct(
    recording: str | os.PathLike[str] | Array,
    *,
    key: str | None = None,
    raw: Raw | Mapping[str, Any] | None = None,
    axes: str | None = None,
    crop: list[int] | None = None,
    swap_bytes: bool | None = None,
    radiometry: Radiometry | Mapping[str, Any] | None = None,
) -> CorrectedRecording:
    """Correct a recording of a moving camera: `correct("drive.avi").frames`.

    Args:
        recording: A file, folder or glob of any length, or frames (N, h, w).
        key: Name of the array in a file that holds several.
        raw: Layout of a file without a header: `{"width": 640, "height": 512}`.
        axes: Order of the array's axes, as `data.axes`: "hwn" for (height, width, frames).
        crop: Part of the frames, [y0, y1, x0, x1], as `data.crop`.
        swap_bytes: Whether the bytes of each sample are swapped, of a file.
        radiometry: Conversion to kelvin, of a file, as `data.radiometry`.

    Raises:
        DataError: It cannot be read, has few frames, or the camera stands still.
        ConfigError: An option is wrong.
    """
    options = {
        "key": key,
        "raw": raw,
        "axes": axes,
        "crop": crop,
        "swap_bytes": swap_bytes,
        "radiometry": radiometry,
    }
    given = {name: value for name, value in options.items() if value is not None}
    data = Data(**validate(Data, given, "correct"))
    if isinstance(recording, np.ndarray):
        if recording.ndim != 3 or not len(recording):
            raise DataError(f"frames of shape {recording.shape}; expected (frames, height, width)")
        if of_file := next(iter(given.keys() - {"axes", "crop"}), None):
            raise ConfigError(f"correct: '{of_file}' is for a file, and the frames are an array")
        frames = oriented(recording, axes, "frames") if axes else recording
        read: Callable[[], Iterator[Array]] = functools.partial(cropped, frames, crop)
    else:
        read = functools.partial(stream_data, data.model_copy(update={"path": os.fspath(recording)}))
    return CorrectedRecording.of(read)
