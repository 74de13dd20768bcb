"""Total variation."""

from __future__ import annotations

from typing import Any

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
        if value.device.type == "cpu":
            energy: Tensor = _OnCPU.apply(value, float(rounding))
            return energy
        return total_variation(value, rounding)

    def stiffness(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight / sqrt(|∇x|² + e²)`, of the gradient."""
        rounding = self.rounding / self.weight.clamp(min=1e-12)
        return 0.0, float((self.weight * (squared_gradient(value) + rounding.square()).rsqrt()).mean())

    def natural(self, noise: float) -> float:
        """One nat for a step of `SCALE` standard deviations."""
        return 1 / (SCALE * noise)


def total_variation(value: Tensor, rounding: Tensor) -> Tensor:
    """`Σ sqrt(|∇x|² + e²) - e`."""
    squared = squared_gradient(value)
    # The same as the difference, without its cancellation.
    return (squared / (torch.sqrt(squared + rounding.square()) + rounding)).sum(dtype=torch.float64)


class _OnCPU(torch.autograd.Function):
    """The same in one pass, which finds the gradient as well."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, rounding: float) -> Tensor:
        from deepir.loops import spread
        from deepir.loops.tv import total_variation

        pictures = value.reshape(-1, *value.shape[-2:]).contiguous()
        gradient = torch.empty_like(pictures)
        energy = torch.empty(pictures.shape[:-1], dtype=torch.float64)
        for i, picture in enumerate(pictures):
            spread(total_variation, len(picture), picture, rounding, energy[i], gradient[i])
        ctx.save_for_backward(gradient.reshape(value.shape))
        return energy.sum()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None]:
        (found,) = ctx.saved_tensors
        return gradient.to(found) * found, None
