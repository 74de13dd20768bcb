"""What a camera does with its shutter, and a laboratory with two black bodies."""

from __future__ import annotations

import dataclasses

import numpy as np

from deepir.baselines.average import Array, correct_and_average
from deepir.burst import Burst
from deepir.calibration import maps_from_flats, mean_frame
from deepir.config import Config
from deepir.errors import ConfigError, DataError
from deepir.io import stream_frames
from deepir.registry import register
from deepir.result import Result


@register("method", "flat_field")
def flat_field(
    burst: Burst,
    config: Config,
    *,
    shutter: str | None = None,
    cold: str | None = None,
    hot: str | None = None,
) -> Result:
    """Calibrate with frames of a uniform shutter, or of a cold and a hot black body; then register and average.

    One point gives each pixel's offset, two its gain and offset: D. L. Perry, E. L. Dereniak: Linear theory of
    nonuniformity correction in infrared staring sensors, Optical Engineering 32 (1993). `shutter`, `cold` and `hot` are
    files of frames, which are averaged. With all three, gain is from the black bodies and offset from the shutter.

    Raises:
        ConfigError: No file is given, or one black body only.
        DataError: The flat frames are of another size than the burst's, or the black bodies are at one temperature.
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
    return correct_and_average(
        dataclasses.replace(burst, bad_pixels=bad), config, maps.gain, np.where(bad, 0, offset)
    )


def read_flat(path: str, option: str, size: tuple[int, int]) -> Array:
    """The mean (h, w) of the frames of a file."""
    found = mean_frame(stream_frames(path), path)
    if found.shape != size:
        raise DataError(
            f"{path}: frames of {found.shape[0]} x {found.shape[1]} px (method.{option}), the burst's have "
            f"{size[0]} x {size[1]}"
        )
    return found
