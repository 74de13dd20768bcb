"""A gain of each frame, as an automatic gain control sets it: how strong the pattern is in each.

`∇y_k = f_k ∇p + a heavy-tailed gradient of the scene`, with the pattern p that all frames share: f_k by reweighted
least squares. An estimated p is too weak or too strong in all frames alike, so only the ratios of f_k count.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.multiview.gradients import AXES

ROUNDS = 10  # of reweighting
#: Largest gradients of the pattern, in their root mean square, that count: of a defect they say nothing.
GRADIENT_LIMIT = 6.0
#: Gradients that say the same: those of neighbours.
CORRELATED_GRADIENTS = 4.0
#: Root mean square of (f_k - 1) in its standard errors, and by itself, from which frames have gains of their own.
SIGNIFICANCE, MIN_SPREAD = 4.0, 0.05


def frame_gains(frames: Tensor, usable: Tensor, pattern: Tensor) -> Tensor | None:
    """Gains (N,) of frames (N, h, w), of geometric mean one; None where they are not clearly different.

    Args:
        frames: in any units.
        usable: which samples count, same shape.
        pattern: what they share, (h, w).
    """
    found = [pattern_gain(frame, good, pattern) for frame, good in zip(frames, usable, strict=True)]
    gains, errors = torch.stack([each[0] for each in found]), torch.stack([each[1] for each in found])
    if not bool((gains > SIGNIFICANCE * errors).all()):
        return None
    gains = gains / gains.log().mean().exp()
    apart = gains - gains.median()
    spread = float((apart / errors).square().mean().sqrt())
    return gains if spread > SIGNIFICANCE and float(apart.square().mean().sqrt()) > MIN_SPREAD else None


def pattern_gain(frame: Tensor, usable: Tensor, pattern: Tensor) -> tuple[Tensor, Tensor]:
    """How strong the pattern (h, w) is in a frame, and the standard error of that."""
    steps, shared = [], []
    for axis in AXES:
        counts = usable.narrow(axis, 1, usable.shape[axis] - 1) & usable.narrow(
            axis, 0, usable.shape[axis] - 1
        )
        steps.append(frame.double().diff(dim=axis)[counts])
        shared.append(pattern.double().diff(dim=axis)[counts])
    y, p = torch.cat(steps), torch.cat(shared)
    bulk = p.abs() < GRADIENT_LIMIT * p.square().mean().sqrt()
    y, p = y[bulk], p[bulk]
    gain, weight = y.new_ones(()), torch.ones_like(y)
    for _ in range(ROUNDS):
        gain = (weight * y * p).sum() / (weight * p * p).sum().clamp_min(1e-300)
        rest = (y - gain * p).square()
        weight = 1 / (rest.median().clamp_min(1e-300) + rest)
    variance = (
        CORRELATED_GRADIENTS
        * (weight.square() * rest * p * p).sum()
        / (weight * p * p).sum().square().clamp_min(1e-300)
    )
    return gain, variance.sqrt()
