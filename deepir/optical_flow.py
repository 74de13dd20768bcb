"""Dense motion of corrected frames against the first, from coarse pictures to fine: where a flow starts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor

from deepir.build import scaled
from deepir.fidelity import Huber
from deepir.noise import MAD
from deepir.operators import Chain, Warp
from deepir.operators.points import displacements
from deepir.operators.warp import coords
from deepir.priors.constant import Constant
from deepir.priors.flow import Flow
from deepir.problem import Problem
from deepir.solve import Stage, Step, solve

FACTORS = (8, 4, 2)  # by which the pictures are coarser
LEAST = 16  # px of a picture's shorter side
#: Of the control points on each picture, in its px.
SPACING = 4
ITERATIONS = 60
ROUNDS = 3  # at each factor, with new weights


def optical_flow(frames: Tensor, known: Tensor, motion: Tensor, weight: float, finest: float) -> Tensor:
    """Where each pixel looks, (N, h, w, 2).

    frames: (N, h, w), without the sensor's pattern. known: the same shape, bool. motion: (N, 3, 3), where to start.
    weight: of a `Flow`. finest: least spacing of its control points, px.
    """
    size = (frames.shape[1], frames.shape[2])
    start = coords(motion.double(), size)
    beside = torch.zeros(len(frames), 2, *size)
    for factor in FACTORS:
        if min(size) // factor < LEAST:
            continue
        few, mean = averaged(frames, known, factor)
        own = (few.shape[1], few.shape[2])
        field = Flow((len(frames),), size=own, ratio=1 / factor, spacing=max(factor * SPACING, finest), weight=weight)
        field.init_from(scaled(motion, 1 / factor))
        field.init_from(field() + resized(beside, own).permute(0, 2, 3, 1) / factor)
        _fit(field, few, mean)
        moved = field().detach() - coords(field.base, own).to(few)
        beside = factor * resized(moved.permute(0, 3, 1, 2), size)
    return start.to(frames) + beside.permute(0, 2, 3, 1)


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
