"""Stray flux from one frame, by total variation."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.arrays.statistics import sample_noise
from deepir.fields.basis_expansion import BasisExpansion

#: Highest spatial frequency of the fit, half waves over the frame: finer structure is more likely the scene's.
MAX_STRAY_FREQUENCY = 6.0
#: Shorter side to which the frame is reduced, px.
REDUCED_SIDE = 128
#: Rounds of reweighting.
N_REWEIGHTING_ROUNDS = 50


@torch.no_grad()
def tv_minimising_fit(frame: Tensor, usable: Tensor, field: BasisExpansion) -> Tensor:
    """Low-order map whose subtraction minimises the total variation of a frame, by reweighted least squares.

    Edges of the scene have little weight; a slope of the scene is attributed to stray flux.

    Args:
        frame: (h, w).
        usable: Pixels that count, (h, w), bool.
        field: Its basis is used, up to `MAX_STRAY_FREQUENCY`.

    Returns:
        The map, (h, w), float64.
    """
    one = torch.eye(len(field.values), dtype=frame.dtype, device=frame.device)
    terms = torch.stack([field.synthesise(each) for each in one[field.frequency <= MAX_STRAY_FREQUENCY]])
    side = max(1, min(frame.shape) // REDUCED_SIDE)
    coverage = F.avg_pool2d(usable.double()[None], side)
    maps = F.avg_pool2d(torch.cat((frame[None], terms)).double() * usable, side) / coverage.clamp(min=1e-6)
    known = (coverage > 0.5).double()
    slopes = torch.cat([maps.diff(dim=axis).flatten(1) for axis in (1, 2)], 1)
    valid = torch.cat([known.unfold(axis, 2, 1).amin(-1).flatten() for axis in (1, 2)])
    noise = max(2**0.5 * sample_noise(frame[None], usable[None]) / side, 1e-9 * float(slopes[0].abs().max()))
    found = slopes.new_zeros(len(terms))
    for _ in range(N_REWEIGHTING_ROUNDS):
        left = (slopes[0] - found @ slopes[1:]).abs()
        weighted = slopes[1:] * (valid / left.clamp(min=noise))
        found = torch.linalg.pinv(weighted @ slopes[1:].T, hermitian=True) @ (weighted @ slopes[0])
    return torch.tensordot(found, terms.double(), 1)
