"""Total variation."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.penalties.penalty import Penalty, squared_gradient
from deepir.registry import register

#: Typical step between neighbours, in standard deviations of the noise: the best on the truth was 1 to 3 on
#: eight pictures with 3, 5 and 10 frames.
SCALE = 1.6


@register("penalty", "tv")
class TV(Penalty):
    """Isotropic total variation, `Σ |∇x|`, with forward differences (Rudin, Osher, Fatemi 1992).

    Rounded at `rounding`, in units of `1 / weight`, so that it is smooth enough for L-BFGS.
    """

    def __init__(self, *, weight: float | None = None, rounding: float = 0.1) -> None:
        super().__init__(weight=weight)
        if not 0 < rounding < float("inf"):
            raise ValueError(f"rounding must be a positive number, not {rounding}")
        self.rounding = rounding

    def energy(self, value: Tensor) -> Tensor:
        """`Σ sqrt(|∇x|² + e²) - e`, with `e = rounding / weight`."""
        rounding = self.rounding / self.weight.clamp(min=1e-12)
        squared = squared_gradient(value)
        # The same as the difference, without its cancellation.
        return (squared / (torch.sqrt(squared + rounding.square()) + rounding)).sum(dtype=torch.float64)

    def natural(self, noise: float) -> float:
        """One nat for a step of `SCALE` standard deviations."""
        return 1 / (SCALE * noise)
