"""Whether what the fit leaves of the frames is noise, or something that is neither scene nor pattern.

Noise of one pixel says nothing of the next. What is left next to each other is alike or opposite by the freedom that
the fit has; a few pixels on it is not, unless clouds, leaves or shadows changed, things are at many depths, the frames
are blurred, each by its own motion, or the pixels are slow: then what is left is alike to how the frame before differs.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.operators import Sensor
from deepir.problem import Problem

APART = (3, 5)  # px, along rows and columns
WILD = 3.0  # standard deviations at which what is left is cut off
#: Correlation of what is left so far apart from which it is no noise: 0.08 at most where the model is right.
ALIKE = 0.12
#: Correlation with what the frame before shows beside from which pixels are slow: 0.05 at most where they are not.
TRAILS = 0.15


@torch.no_grad()
def residual_correlation_message(problem: Problem) -> list[str]:
    """Say so if the fit leaves more than noise of the frames, and why if that is thermal lag."""
    stages = [stage for _, stage in problem.operator.named()]
    if not isinstance(stages[-1], Sensor) or min(problem.data.shape[2:]) < 4 * max(APART):
        return []
    values = problem.values()
    left = problem.data - problem.predict(values)
    left.mul_(problem.precision.sqrt()).clamp_(-WILD, WILD)
    several = len(left) > 2 and not any(stage.temporal for stage in stages)
    if several and trailing(left, problem.flux(values), problem.precision) > TRAILS:
        return [
            "the frames trail: each shows some of the one before it still, as slow pixels do (thermal lag). Move the "
            "camera more slowly, or let it rest before each frame; where it moves evenly, `deepir run deblur_lag "
            "data.fps=...` takes the tail away"
        ]
    if (alike := correlation(left, problem.precision)) < ALIKE:
        return []
    return [
        f"the frames hold what is neither scene nor pattern: what is left of them is alike by {alike:.2f} "
        f"{APART[0]} and {APART[1]} px apart, and noise is not. Things are at many depths (then `deepir run flow` "
        "follows them), clouds, leaves, shadows or the shading change, or the camera moves within a frame: the scene "
        "is less sure than its deviation says"
    ]


def correlation(left: Tensor, precision: Tensor) -> float:
    """Of what is left of frames (N, 1, h, w), `APART` px along rows and columns: the mean, the least by distance.

    Noise of frames that a camera enlarged, or packed as JPEG, is alike 3 px apart, but not 5.
    """
    counts = (precision > 0).to(left.dtype)
    power = (left.square().sum((1, 2, 3)) / counts.sum((1, 2, 3)).clamp(min=1)).clamp(min=1e-30)
    found = []
    for apart in APART:
        both = []
        for along in (2, 3):
            size = left.shape[along] - apart
            here, there = (each.narrow(along, 0, size) for each in (left, counts))
            beyond, too = (each.narrow(along, apart, size) for each in (left, counts))
            pairs = (there * too).sum((1, 2, 3)).clamp(min=1)
            both.append((here * beyond).sum((1, 2, 3)) / pairs / power)
        found.append(float(torch.stack(both).mean()))
    return min(found)


def trailing(left: Tensor, flux: Tensor, precision: Tensor) -> float:
    """How alike what is left of frames is to what the frame before shows beside; the median over frames.

    `left` (N, 1, h, w) is in standard deviations, `flux` is what falls on the detector.
    """
    beside = (flux[:-1] - flux[1:]).mul_(precision[1:].sqrt())
    beside = beside - beside.mean((1, 2, 3), keepdim=True)
    product = (left[1:] * beside).sum((1, 2, 3))
    power = beside.square().sum((1, 2, 3)) * left[1:].square().sum((1, 2, 3))
    return float((product / power.sqrt().clamp(min=1e-30)).median())
