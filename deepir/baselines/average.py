"""Register and average: what everyone does first."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import torch

from deepir.build import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.joint import registered
from deepir.problems.definition import filled
from deepir.registry import lookup, register
from deepir.result import Result, neutral
from deepir.solve import Progress


@register("method", "average")
def average(
    burst: Burst,
    config: Config,
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Path | None = None,
) -> Result:
    """Register the frames and average them; gain and offset stay as they are."""
    definition = lookup("problem", config.problem, "problem")()
    motion, used, messages = registered(burst, config, definition)
    kept = dataclasses.replace(burst, frames=burst.frames[used], valid=burst.valid[used])
    problem, geometry = build(config, kept, None if motion is None else motion[used])
    with torch.no_grad():
        values = problem.values()
        mean, weight = problem.backproject(values)
        scene = filled(mean, weight > 0.3 * weight.max())[0, 0]
    y0, y1, x0, x1 = geometry.window
    result = neutral(scene[y0:y1, x0:x1].numpy(), len(used), burst.size, burst.bad_pixels)
    if motion is not None:
        result.motion[used] = values["motion"].numpy()
        result.motion[~used] = float("nan")
    result.frames_used, result.messages = used, messages
    result.metrics = {"iterations": 0, "evaluations": 0, "stop_reason": "converged"}
    return result
