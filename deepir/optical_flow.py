"""Dense motion of corrected frames against the first, from coarse pictures to fine: where a flow starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor

from deepir.fidelity import Huber
from deepir.noise import MAD
from deepir.operators import Chain, Warp
from deepir.priors.constant import Constant
from deepir.priors.flow import Flow
from deepir.problem import Problem
from deepir.solve import Stage, Step, solve

FACTORS = (8, 4, 2)  # by which the pictures are coarser
LEAST = 16  # px of a picture's shorter side
#: Of the control points on each picture, in its px.
SPACING = 4
ITERATIONS = 40
ROUNDS = 3  # at each factor, with new weights


def optical_flow(frames: Tensor, known: Tensor, flow: Flow) -> Tensor:
    """Displacements (N, 2, h, w), x and y in px, beside where a flow starts.

    frames: (N, h, w), without the sensor's pattern. known: the same shape, bool, where they show something.
    """
    size = (frames.shape[1], frames.shape[2])
    start, beside = flow.start.permute(0, 3, 1, 2), frames.new_zeros(len(frames), 2, *size)
    for factor in FACTORS:
        if min(size) // factor < LEAST:
            continue
        few, mean = averaged(frames, known, factor)
        own = (few.shape[1], few.shape[2])
        spacing = max(factor * SPACING, flow.spacing)
        field = Flow((len(frames),), size=own, ratio=1 / factor, spacing=spacing, weight=float(flow.weight))
        field.start = resized(start / factor, own).permute(0, 2, 3, 1)
        field.init_from(field.start + resized(beside / factor, own).permute(0, 2, 3, 1))
        _fit(field, few, mean)
        moved = (field() - field.start).detach().permute(0, 3, 1, 2)
        beside = factor * resized(moved, size)
    return beside


def averaged(frames: Tensor, known: Tensor, factor: int) -> tuple[Tensor, Tensor]:
    """Means of `factor` x `factor` known px about the centre, and where there are any: at least half."""
    top, left = ((side % factor) // 2 for side in frames.shape[1:])
    counts = known[:, top:, left:].to(frames)
    share = F.avg_pool2d(counts, factor)
    mean = F.avg_pool2d(counts * frames[:, top:, left:], factor) / share.clamp(min=1e-6)
    return mean, share > 0.5


def resized(maps: Tensor, size: Sequence[int]) -> Tensor:
    return F.interpolate(maps, size=tuple(size), mode="bilinear", align_corners=False)


def _fit(field: Flow, frames: Tensor, known: Tensor) -> None:
    """Move the field's displacements so that each frame is the first, moved."""
    size = (frames.shape[1], frames.shape[2])
    first = np.where(known[0], frames[0], float(frames[0][known[0]].median()))
    spline = ndimage.spline_filter(first.astype(np.float64), order=3, mode="mirror")
    scene = Constant((1, 1, *size))
    scene.values.copy_(torch.from_numpy(spline))
    data = torch.where(known, frames, 0)[:, None]
    problem = Problem(
        Chain({"warp": Warp(size, size, (0, 0))}), {"scene": scene, "motion": field}, data, known[:, None].to(data),
        fidelity=Huber(),
    )  # fmt: skip

    def weigh(problem: Problem) -> None:
        values = problem.values()
        seen = problem.valid(values) & known[:, None]
        residual = (problem.predict(values) - data)[1:][seen[1:]]
        spread = MAD * float((residual - residual.median()).abs().median())
        problem.precision.copy_(seen / max(spread, 1e-30) ** 2)

    step = (Step(("motion",)),)
    solve(problem, [Stage(f"{i}", step, ITERATIONS, prepare=weigh) for i in range(ROUNDS)])
