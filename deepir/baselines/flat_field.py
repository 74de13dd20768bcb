"""What a camera does with its shutter, and a laboratory with two black bodies."""

from __future__ import annotations

import numpy as np

from deepir.baselines.average import Array, corrected
from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import ConfigError, DataError
from deepir.io import read_frames
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
        DataError: The flat frames are of another size, or hot is not hotter than cold.
    """
    if (cold is None) != (hot is None) or (shutter is None and cold is None):
        raise ConfigError(
            "method 'flat_field': give flat frames: method.shutter=FILE, or method.cold=FILE method.hot=FILE"
        )
    gain = np.ones(burst.size)
    if cold is not None and hot is not None:
        low = flat(cold, "cold", burst.size)
        gain = flat(hot, "hot", burst.size) - low
        if not np.median(gain) > 0:
            raise DataError(
                f"{hot}: the frames are not hotter than those of {cold}; exchange method.cold and hot"
            )
    level = flat(shutter, "shutter", burst.size) if shutter is not None else low
    good = ~burst.bad_pixels
    gain = gain / gain[good].mean()
    return corrected(burst, config, gain, level - gain * level[good].mean())


def flat(path: str, option: str, size: tuple[int, int]) -> Array:
    """The mean (h, w) of the frames of a file."""
    frames = read_frames(path).frames.astype(np.float64)
    if frames.shape[1:] != size:
        raise DataError(
            f"{path}: frames of {frames.shape[1]} x {frames.shape[2]} px (method.{option}), the burst's have "
            f"{size[0]} x {size[1]}"
        )
    return np.asarray(frames.mean(0))
