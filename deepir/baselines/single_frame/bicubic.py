"""Cubic interpolation of one frame."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from scipy import ndimage

from deepir.arrays.windows import fill_nearest
from deepir.assembly.problem import build
from deepir.baselines.average import Array
from deepir.burst import Burst
from deepir.config import Config
from deepir.registry import register
from deepir.result import Result, neutral


@register("method", "bicubic")
def bicubic(burst: Burst, config: Config) -> Result:
    """Enlarge the first frame by a cubic spline; gain and offset stay as they are."""
    first = dataclasses.replace(burst, frames=burst.frames[:1], valid=burst.valid[:1])
    _, geometry = build(config, first)
    frame, good = (torch.from_numpy(each)[None] for each in (first.frames, first.valid & ~burst.bad_pixels))
    filled_frame = fill_nearest(frame, good)[0, 0].numpy()
    result = neutral(enlarge(filled_frame, geometry.ratio), len(burst.frames), burst.size, burst.bad_pixels)
    result.frames_used[1:] = False
    result.motion[1:] = float("nan")
    result.metrics = {"iterations": 0, "evaluations": 0, "stop_reason": "converged"}
    return result


def enlarge(frame: Array, ratio: float) -> Array:
    """A frame (h, w) on a grid `ratio` times as fine; pixels are areas, so that the frame's corners stay in place."""
    return np.asarray(ndimage.zoom(frame, ratio, order=3, mode="mirror", grid_mode=True))
