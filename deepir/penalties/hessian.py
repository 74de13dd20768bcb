"""Total variation of the second order."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.penalties.penalty import Penalty
from deepir.registry import register

SCALE = 3.2  # typical kink, in standard deviations of the noise


@register("penalty", "hessian")
class Hessian(Penalty):
    """The Frobenius norm of the second differences, `Σ |∇²x|`: slopes are free, kinks cost.

    (Lefkimmiatis, Bourquard, Unser 2012, "Hessian-based norm regularization for image restoration".) Rounded at
    `rounding`, in units of `1 / weight`, so that it is smooth enough for L-BFGS.
    """

    def __init__(self, *, weight: float | None = None, rounding: float = 0.1) -> None:
        super().__init__(weight=weight)
        if not 0 < rounding < float("inf"):
            raise ValueError(f"rounding must be a positive number, not {rounding}")
        self.rounding = rounding

    def energy(self, value: Tensor) -> Tensor:
        """`Σ sqrt(xx² + yy² + 2 xy²  + e²) - e`, with `e = rounding / weight`."""
        e = self.rounding / self.weight.clamp(min=1e-12)
        along_x = F.pad(value.diff(n=2, dim=-1), (1, 1))
        along_y = F.pad(value.diff(n=2, dim=-2), (0, 0, 1, 1))
        across = F.pad(value.diff(dim=-1).diff(dim=-2), (0, 1, 0, 1))
        squared = along_x.square() + along_y.square() + 2 * across.square()
        return (squared / (torch.sqrt(squared + e.square()) + e)).sum(dtype=torch.float64)

    def natural(self, noise: float) -> float:
        """One nat for a kink of `SCALE` standard deviations."""
        return 1 / (SCALE * noise)
