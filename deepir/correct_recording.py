"""Correct a recording from Python; one of a few frames is a burst, and goes the way of the problem `nuc`."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from deepir.arrays import Array
from deepir.config.components import validate
from deepir.config.schema import Data, Radiometry, Raw
from deepir.errors import ConfigError, DataError
from deepir.io import cropped, stream_data
from deepir.io.inspection.samples import oriented
from deepir.recording.correct import CorrectedRecording
from deepir.recording.estimate import SensorEstimate


def sensor_of_burst(frames: Array) -> SensorEstimate:
    """The sensor of a few frames (N, h, w), as `run("nuc")` finds it.

    Raises:
        DataError: They are too few, or do not register.
    """
    from deepir.api import run  # the whole package, which longer recordings do without

    found = run("nuc", frames=frames)
    gain, level = found.gain.astype(float), float(np.nanmedian(frames))
    offset = found.offset - level * (1 - gain)
    good = ~found.bad_pixels
    gain, offset = np.where(good, gain, 1.0), np.where(good, offset, 0.0)
    messages = tuple(found.messages)
    return SensorEstimate(gain, offset, found.bad_pixels, level, None, "gain and offset", 0.0, messages)


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
    options = {"key": key, "raw": raw, "axes": axes, "crop": crop, "swap_bytes": swap_bytes, "radiometry": radiometry}
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
    return CorrectedRecording.of(read, of_few=sensor_of_burst)
