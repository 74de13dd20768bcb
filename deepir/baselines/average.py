"""Register and average: what everyone does first, and what the rivals do last."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch
from scipy import ndimage

from deepir.arrays.fill import fill_nearest
from deepir.build.problem import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.operators.homography import homographies
from deepir.pipeline.register import register_frames
from deepir.registry import lookup, register
from deepir.result import Result, neutral, to_gauge

Array = np.ndarray[Any, Any]
#: Motion (N, 3, 3) of each frame, which frames are used, and messages: see `deepir.pipeline.register.registered`.
Found = tuple[torch.Tensor | None, Array, list[str]]

LEAST, MOST = 0.2, 5.0  # gains, in medians, beyond which a pixel is a bad one


def pulled_back(frames: Array, valid: Array, motion: Array, ratio: float = 1.0) -> torch.Tensor:
    """The mean of frames (N, h, w) on a grid `ratio` times as fine as frame 0's, by cubic spline interpolation.

    What no frame shows is filled in.
    """
    height, width = (round(ratio * side) for side in frames.shape[1:])
    total, count = np.zeros((2, height, width))
    for frame, good, back in zip(whole(frames, valid), valid, np.linalg.inv(motion), strict=True):
        at = indices(places(back, (height, width), ratio), frame.shape)
        seen = ndimage.map_coordinates(good.astype(np.float32), at, order=1, cval=0) > 0.99
        total += seen * ndimage.map_coordinates(frame, at, order=3, mode="mirror")
        count += seen
    mean = torch.from_numpy(total / count.clip(min=1))[None, None]
    return fill_nearest(mean, torch.from_numpy(count > 0)[None, None])[0, 0]


def places(motion: Array, size: tuple[int, ...], ratio: float = 1.0) -> Array:
    """Where the pixels of a grid (h, w), `ratio` times as fine as a frame, look: (y, x) from the centre, (2, h, w)."""
    y, x = ((np.arange(side) - (side - 1) / 2) / ratio for side in size)
    at = motion @ np.stack([each.ravel() for each in np.broadcast_arrays(x, y[:, None], 1.0)])
    return np.asarray((at[1::-1] / at[2]).reshape(2, *size))


def indices(places: Array, shape: tuple[int, ...], ratio: float = 1.0) -> Array:
    """Indices into an array (h, w), `ratio` times as fine as a frame, of places (2, ...) from the centre."""
    middle = (np.array(shape) - 1) / 2
    return np.asarray(ratio * places + middle.reshape(2, *(1,) * (places.ndim - 1)))


def whole(frames: Array, valid: Array) -> Array:
    """Frames (N, h, w) in which samples that are not valid are like their nearest neighbour that is."""
    pairs = zip(torch.from_numpy(frames), torch.from_numpy(valid), strict=True)
    return np.stack(
        [fill_nearest(frame[None, None], good[None, None])[0, 0].numpy() for frame, good in pairs]
    )


@register("method", "average")
def average(burst: Burst, config: Config) -> Result:
    """Register the frames of a scene and average them; gain and offset stay as they are."""
    return averaged(burst, config, burst.frames)


def find(burst: Burst, config: Config) -> Found:
    """Register the burst: the fixed pattern is no obstacle to it."""
    return register_frames(burst, config, lookup("problem", config.problem, "problem")())


def averaged(burst: Burst, config: Config, frames: Array, found: Found | None = None) -> Result:
    """Register the burst and average `frames`, (N, h, w), which are its frames corrected; gain one, offset zero.

    `found` is the registration, where it is known.
    """
    motion, used, messages = found or find(burst, config)
    kept = dataclasses.replace(burst, frames=frames[used].astype(np.float32), valid=burst.valid[used])
    problem, geometry = build(config, kept, None if motion is None else motion[used])
    if motion is not None:
        good = kept.valid & ~kept.bad_pixels
        scene = pulled_back(kept.frames, good, motion[used].numpy(), geometry.ratio)
    else:
        with torch.no_grad():
            mean, weight = problem.backproject(problem.values())
            scene = geometry.crop(fill_nearest(mean, weight > 0.3 * weight.max()))
    result = neutral(scene.numpy(), len(used), burst.size, burst.bad_pixels)
    if motion is not None:
        result.motion[used] = homographies(problem.values()["motion"]).detach().numpy()
        result.motion[~used] = float("nan")
    result.frames_used, result.messages = used, messages
    result.metrics = {"iterations": 0, "evaluations": 0, "stop_reason": "converged"}
    return result


def corrected(burst: Burst, config: Config, gain: Array, offset: Array, found: Found | None = None) -> Result:
    """Correct the frames for a sensor's gain and offset, (h, w) in any gauge, then register and average them.

    Pixels that hardly answer to flux, or far too much, become bad ones.
    """
    found = found or find(burst, config)
    gain = gain / np.median(gain[~burst.bad_pixels])
    good = ~burst.bad_pixels & (gain > LEAST) & (gain < MOST)
    gain = np.where(good, gain, 1.0)
    burst = dataclasses.replace(burst, bad_pixels=~good)
    result = averaged(burst, config, (burst.frames - offset) / gain, found)
    result.gain, result.offset = gain, offset
    to_gauge(result)
    return result
