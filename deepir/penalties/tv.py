"""Total variation."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.penalties.penalty import Penalty
from deepir.registry import register


@register("penalty", "tv")
class TV(Penalty):
    """Isotropic total variation, `Σ |∇x|`, with forward differences (Rudin, Osher, Fatemi 1992).

    Rounded at `rounding`, in units of `1 / weight`, so that it is smooth enough for L-BFGS.
    """

    def __init__(self, *, weight: float | None = None, rounding: float = 0.1) -> None:
        super().__init__(weight=weight)
        self.rounding = rounding

    def energy(self, value: Tensor) -> Tensor:
        """`Σ sqrt(|∇x|² + e²) - e`, (..., H, W) -> scalar."""
        corner = value[..., :-1, :-1]
        right, down = value[..., :-1, 1:] - corner, value[..., 1:, :-1] - corner
        rounding = self.rounding / self.weight.clamp(min=torch.finfo(value.dtype).tiny ** 0.5)
        return (torch.sqrt(right.square() + down.square() + rounding.square()) - rounding).sum(dtype=torch.float64)
