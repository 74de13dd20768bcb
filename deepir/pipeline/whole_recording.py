"""The method `recording`: a whole recording corrected as by `deepir correct`, for runs, comparisons and batches."""

from __future__ import annotations

import dataclasses

import numpy as np

from deepir.burst import Burst
from deepir.config import Config
from deepir.io.inspection.samples import has_eight_bits
from deepir.recording.correct import CorrectedRecording
from deepir.registry import register
from deepir.result import Result, neutral


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
