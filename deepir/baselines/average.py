"""Register and average: what everyone does first."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from scipy import ndimage

from deepir.build import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.joint import registered
from deepir.operators.points import homographies
from deepir.problems.definition import filled
from deepir.registry import lookup, register
from deepir.result import Result, neutral
from deepir.solve import Progress


def pulled_back(
    frames: np.ndarray, valid: np.ndarray, motion: np.ndarray, ratio: float = 1.0
) -> torch.Tensor:
    """The mean of frames (N, h, w) on a grid `ratio` times as fine as frame 0's, by cubic spline interpolation.

    What no frame shows is filled in.
    """
    height, width = (round(ratio * side) for side in frames.shape[1:])
    y, x = ((np.arange(side) - (side - 1) / 2) / ratio for side in (height, width))
    points = np.stack([each.ravel() for each in np.broadcast_arrays(x, y[:, None], 1.0)])
    centre = np.array([[(side - 1) / 2] for side in (*frames.shape[:0:-1], 1)])
    total, count = np.zeros((2, height, width))
    for frame, good, back in zip(frames, valid, np.linalg.inv(motion), strict=True):
        at = back @ points
        at = ((at / at[2]) + centre)[1::-1].reshape(2, height, width)
        whole = filled(torch.from_numpy(frame)[None, None], torch.from_numpy(good)[None, None])[0, 0].numpy()
        seen = ndimage.map_coordinates(good.astype(np.float32), at, order=1, cval=0) > 0.99
        total += seen * ndimage.map_coordinates(whole, at, order=3, mode="mirror")
        count += seen
    mean = torch.from_numpy(total / count.clip(min=1))[None, None]
    return filled(mean, torch.from_numpy(count > 0)[None, None])[0, 0]


@register("method", "average")
def average(
    burst: Burst,
    config: Config,
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Path | None = None,
) -> Result:
    """Register the frames of a scene and average them; gain and offset stay as they are."""
    definition = lookup("problem", config.problem, "problem")()
    motion, used, messages = registered(burst, config, definition)
    kept = dataclasses.replace(burst, frames=burst.frames[used], valid=burst.valid[used])
    problem, geometry = build(config, kept, None if motion is None else motion[used])
    if motion is not None:
        good = kept.valid & ~kept.bad_pixels
        scene = pulled_back(kept.frames, good, motion[used].numpy(), geometry.ratio)
    else:
        with torch.no_grad():
            mean, weight = problem.backproject(problem.values())
            scene = geometry.crop(filled(mean, weight > 0.3 * weight.max()))
    result = neutral(scene.numpy(), len(used), burst.size, burst.bad_pixels)
    if motion is not None:
        result.motion[used] = homographies(problem.values()["motion"]).detach().numpy()
        result.motion[~used] = float("nan")
    result.frames_used, result.messages = used, messages
    result.metrics = {"iterations": 0, "evaluations": 0, "stop_reason": "converged"}
    return result
