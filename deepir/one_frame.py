"""What one frame tells of stray flux: nothing but that the scene is likely to be flat almost everywhere."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.noise import sample_noise
from deepir.priors.terms import Terms

SLOW = 6.0  # half waves over the frame: what is finer is more likely the scene's
SIDE = 128  # px to which the frame is reduced
ROUNDS = 50


@torch.no_grad()
def flattest(frame: Tensor, usable: Tensor, field: Terms) -> Tensor:
    """The slow map (h, w) of `field` that leaves the least total variation when it is taken from the frame (h, w).

    By reweighted least squares. Edges of the scene are few and steep, and count little; a slope of the scene itself is
    taken for stray flux.
    """
    frame, known = frame.double(), usable.double()
    side = max(1, min(frame.shape) // SIDE)
    share = F.avg_pool2d(known[None, None], side)
    terms = torch.stack([field.spread(each) for each in torch.eye(len(field.values))[field.frequency <= SLOW]])
    maps = torch.cat((frame[None], terms.double()))[:, None]
    maps = (F.avg_pool2d(maps * known, side) / share.clamp(min=1e-6))[:, 0]
    (right, sure_right), (down, sure_down) = (
        (maps.diff(dim=axis).flatten(1), (share[0, 0] > 0.5).double().unfold(axis % 2, 2, 1).amin(-1).flatten())
        for axis in (2, 1)
    )
    slopes, sure = torch.cat((right, down), 1), torch.cat((sure_right, sure_down))
    noise = max(2**0.5 * sample_noise(frame[None], usable[None]) / side, 1e-9 * float(slopes[0].abs().max()))
    found = slopes.new_zeros(len(terms))
    for _ in range(ROUNDS):
        rest = (slopes[0] - found @ slopes[1:]).abs()
        weighted = slopes[1:] * (sure / rest.clamp(min=noise))
        found = torch.linalg.lstsq(weighted @ slopes[1:].T, weighted @ slopes[0][:, None]).solution[:, 0]
    return torch.tensordot(found, terms.double(), 1)
