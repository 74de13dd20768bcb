"""Calibration with a shutter, or with two black bodies."""

from __future__ import annotations

import dataclasses

import numpy as np

from deepir.baselines.rival import Array, correct_and_average
from deepir.burst import Burst
from deepir.calibration import maps_from_flats, mean_frame
from deepir.config import Config, Data
from deepir.errors import ConfigError, DataError
from deepir.io import stream_data
from deepir.registry import register
from deepir.result import Result


@register("method", "flat_field")
def flat_field(
    burst: Burst, config: Config, *, shutter: str | None = None, cold: str | None = None, hot: str | None = None
) -> Result:
    """Calibrate with frames of a uniform shutter, or of a cold and a hot black body; then register and average.

    One surface gives the offset of each pixel, two give gain and offset. With all three, the gain is from the black
    bodies and the offset from the shutter.

    Args:
        shutter: File of frames of a uniform shutter.
        cold: File of frames of a cold black body.
        hot: File of frames of a hot black body.

    Raises:
        ConfigError: No file is given, or one black body only.
        DataError: The flat frames differ from the burst in size, or the black bodies have the same temperature.

    Source: D. L. Perry, E. L. Dereniak: Linear theory of nonuniformity correction in infrared staring sensors,
    Optical Engineering 32 (1993).
    """
    if (cold is None) != (hot is None) or (shutter is None and cold is None):
        raise ConfigError(
            "method 'flat_field': give flat frames: method.shutter=FILE, or method.cold=FILE method.hot=FILE"
        )
    named = {"shutter": shutter, "cold": cold, "hot": hot}
    flats = {name: read_flat(path, name, burst.size) for name, path in named.items() if path is not None}
    maps = maps_from_flats([flats["cold"], flats["hot"]] if "hot" in flats else [flats["shutter"]])
    bad, offset = maps.bad_pixels | burst.bad_pixels, maps.offset
    if "shutter" in flats:  # the latest
        offset = flats["shutter"] - maps.gain * flats["shutter"][~bad].mean()
    return correct_and_average(dataclasses.replace(burst, bad_pixels=bad), config, maps.gain, np.where(bad, 0, offset))


def read_flat(path: str, option: str, size: tuple[int, int]) -> Array:
    """Mean (h, w) of the frames of a file; a DataError if they differ from `size` (h, w)."""
    found = mean_frame(stream_data(Data(path=path)), path)
    if found.shape != size:
        raise DataError(
            f"{path}: frames of {found.shape[0]} x {found.shape[1]} px (method.{option}), the burst's have "
            f"{size[0]} x {size[1]}"
        )
    return found
