"""Methods as the pipeline calls them, and that of whole recordings."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable

import numpy as np

from deepir.burst import Burst
from deepir.config import Config
from deepir.config.components import options_schema, validate
from deepir.errors import ConfigError
from deepir.io.inspection.samples import has_eight_bits
from deepir.recording.correct import CorrectedRecording
from deepir.registry import lookup, register
from deepir.result import Result, neutral


def chosen(config: Config) -> tuple[str, Callable[..., Result]]:
    """The name of `config.method`, and the method with its options.

    What is returned is called as `method(burst, config, callbacks=..., checkpoint=...)`; a method that has no use for
    the last two need not take them.

    Raises:
        ConfigError: No method has this name, it does not take these options, or it has no samples.
    """
    given = config.method if isinstance(config.method, dict) else {"type": config.method}
    name = str(given.get("type", "joint"))
    method = lookup("method", name, "method")
    options = {key: value for key, value in given.items() if key != "type"}
    values = validate(options_schema(method), options, f"method '{name}'")
    takes = inspect.signature(method).parameters
    if config.uncertainty.samples and "checkpoint" not in takes:  # it solves no problem
        raise ConfigError(f"uncertainty.samples: method '{name}' has no posterior to draw from; take method=joint")
    return name, lambda *data, **context: method(*data, **{k: v for k, v in context.items() if k in takes}, **values)


@register("method", "recording")
def recording(burst: Burst, config: Config) -> Result:
    """The sensor from a whole recording of a moving camera, as `deepir correct`; each frame's scene is corrected.

    Args:
        burst: All frames of the recording, in their order.
        config: The configuration.

    Raises:
        DataError: Few frames differ, or the camera stands still.
    """
    frames = burst.frames.astype(np.uint8) if has_eight_bits(burst.frames) else burst.frames
    if (lost := ~burst.valid & ~burst.bad_pixels).any():
        frames = np.ma.masked_array(frames, lost)
    corrected = CorrectedRecording.of(lambda: iter(frames))
    maps, estimates = corrected.maps, [each.estimate for each in corrected.segments if each.estimate]
    result = neutral(corrected.frames, len(frames), burst.size, burst.bad_pixels | maps.bad_pixels)
    return dataclasses.replace(
        result,
        gain=maps.gain.astype(np.float32),
        offset=maps.offset.astype(np.float32),
        messages=list(dict.fromkeys(message for each in estimates for message in each.messages)),
        metrics={
            "correction": corrected.estimate.kept,
            "first_frames": [each.first for each in corrected.segments],
            "motion_error": corrected.estimate.motion_error,
            "iterations": 0,
            "evaluations": 0,
            "stop_reason": f"estimated from {len(corrected.keyframes.frames)} of {len(frames)} frames",
        },
    )
