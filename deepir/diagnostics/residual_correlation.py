"""Check whether the residuals of the frames are noise.

The noise of a pixel is independent of its neighbours. The degrees of freedom of the fit correlate adjacent residuals,
but not those a few pixels apart. Correlation at that distance means changing clouds, leaves or shadows, parallax, blur
within frames, or thermal lag: residuals then resemble the difference to the previous frame.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.messages import Message
from deepir.operators import Sensor
from deepir.problem import Problem

#: Distances along rows and columns at which the correlation is taken, px.
CORRELATION_DISTANCES = (3, 5)
#: Residual at which samples are clipped, noise standard deviations.
RESIDUAL_CLIP_SIGMAS = 3.0
#: Correlation of residuals from which they are not noise; 0.08 at most where the model is right.
MIN_RESIDUAL_CORRELATION = 0.12
#: Correlation with the difference to the previous frame from which pixels lag; 0.05 at most where they do not.
MIN_LAG_CORRELATION = 0.15


@torch.no_grad()
def residual_correlation_message(problem: Problem) -> list[str]:
    """Warning for residuals that are not noise, or that show thermal lag; [] otherwise."""
    stages = [stage for _, stage in problem.operator.named()]
    if not isinstance(stages[-1], Sensor) or min(problem.data.shape[2:]) < 4 * max(CORRELATION_DISTANCES):
        return []
    values = problem.values()
    residual = problem.data - problem.predict(values)
    residual.mul_(problem.precision.sqrt()).clamp_(-RESIDUAL_CLIP_SIGMAS, RESIDUAL_CLIP_SIGMAS)
    several = len(residual) > 2 and not any(stage.temporal for stage in stages)
    if several and lag_correlation(residual, problem.flux(values), problem.precision) > MIN_LAG_CORRELATION:
        return [
            Message(
                "thermal-lag",
                "the frames trail: each shows some of the one before it still, as slow pixels do (thermal lag). Move "
                "the camera more slowly, or let it rest before each frame; where it moves evenly, `deepir run "
                "deblur_lag data.fps=...` removes the lag",
            )
        ]
    if (correlation := residual_correlation(residual, problem.precision)) < MIN_RESIDUAL_CORRELATION:
        return []
    near, far = CORRELATION_DISTANCES
    return [
        Message(
            "correlated-residuals",
            f"the residuals are not noise: their correlation at {near} and {far} px is {correlation:.2f}. Possible "
            "causes: parallax (use `deepir run flow`), moving clouds, leaves or shadows, changing shading, or motion "
            "within a frame. The scene's errors exceed its standard deviation",
        )
    ]


def residual_correlation(residual: Tensor, precision: Tensor) -> float:
    """Correlation of residuals at `CORRELATION_DISTANCES` along rows and columns.

    Args:
        residual: (N, 1, h, w), noise standard deviations.
        precision: Same shape; zero where a sample does not count.

    Returns:
        The mean over frames and axes, the smallest over distances: enlarged or JPEG-compressed frames have correlated
        noise at 3 px, but not at 5.
    """
    counts = (precision > 0).to(residual.dtype)
    power = (residual.square().sum((1, 2, 3)) / counts.sum((1, 2, 3)).clamp(min=1)).clamp(min=1e-30)
    found = []
    for apart in CORRELATION_DISTANCES:
        both = []
        for along in (2, 3):
            size = residual.shape[along] - apart
            here, there = (each.narrow(along, 0, size) for each in (residual, counts))
            beyond, too = (each.narrow(along, apart, size) for each in (residual, counts))
            pairs = (there * too).sum((1, 2, 3)).clamp(min=1)
            both.append((here * beyond).sum((1, 2, 3)) / pairs / power)
        found.append(float(torch.stack(both).mean()))
    return min(found)


def lag_correlation(residual: Tensor, flux: Tensor, precision: Tensor) -> float:
    """Correlation of the residuals with the difference of the flux to the previous frame.

    Args:
        residual: (N, 1, h, w), noise standard deviations.
        flux: On the detector, same shape.
        precision: Same shape.

    Returns:
        The median over frames.
    """
    beside = (flux[:-1] - flux[1:]).mul_(precision[1:].sqrt())
    beside = beside - beside.mean((1, 2, 3), keepdim=True)
    product = (residual[1:] * beside).sum((1, 2, 3))
    power = beside.square().sum((1, 2, 3)) * residual[1:].square().sum((1, 2, 3))
    return float((product / power.sqrt().clamp(min=1e-30)).median())
