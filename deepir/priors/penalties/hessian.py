"""Total variation of the second order."""

from __future__ import annotations

import torch.nn.functional as F
from torch import Tensor

from deepir.priors.penalties.smoothed_norm import SmoothedNorm
from deepir.registry import register


@register("penalty", "hessian")
class Hessian(SmoothedNorm):
    """The Frobenius norm of the second differences, `Σ |∇²x|`: slopes are free, kinks cost.

    (Lefkimmiatis, Bourquard, Unser 2012, "Hessian-based norm regularization for image restoration".) Rounded.
    """

    scale = 3.2
    adapts = False  # not tested with a weight map

    def energy(self, value: Tensor) -> Tensor:
        """`Σ sqrt(xx² + yy² + 2 xy²  + e²) - e`, with `e = rounding / weight`."""
        along_x = F.pad(value.diff(n=2, dim=-1), (1, 1))
        along_y = F.pad(value.diff(n=2, dim=-2), (0, 0, 1, 1))
        across = F.pad(value.diff(dim=-1).diff(dim=-2), (0, 1, 0, 1))
        return self.smoothed_l1(along_x.square() + along_y.square() + 2 * across.square())
