"""Total variation, of first and of second order: smoothed norms of differences."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Shape
from deepir.kernels.dispatch import is_compiled
from deepir.priors.penalties.base import SpatiallyWeighted
from deepir.registry import register


class SmoothedNorm(SpatiallyWeighted):
    """A sum of vector lengths, smoothed near zero for L-BFGS.

    Args:
        shape: Of the value; None without a weight map.
        weight: Fixed weight; None for `auto`.
        rounding: Smoothing length, in units of `1 / weight`.

    Raises:
        ValueError: `rounding` is not positive and finite.
    """

    #: Length that costs one nat at the default weight, noise standard deviations.
    scale: ClassVar[float]

    def __init__(
        self, shape: Shape | None = None, *, weight: float | None = None, rounding: float = 0.1
    ) -> None:
        super().__init__(shape, weight=weight)
        if not 0 < rounding < float("inf"):
            raise ValueError(f"rounding must be a positive number, not {rounding}")
        self.rounding = rounding

    @property
    def epsilon(self) -> Tensor:
        """Smoothing length e, units of the value."""
        return self.rounding / self.weight.clamp(min=1e-12)

    def default_weight(self, sigma: float) -> float:
        """One nat per `scale` noise standard deviations."""
        return 1 / (self.scale * sigma)

    def smoothed_l1(self, squared: Tensor) -> Tensor:
        """`Σ m (sqrt(|v|² + e²) - e)` with the weight map m, from `|v|²`; written without cancellation."""
        rounded = squared / (torch.sqrt(squared + self.epsilon.square()) + self.epsilon)
        return (self.weight_map * rounded).sum(dtype=torch.float64)


@register("penalty", "tv")
class TV(SmoothedNorm):
    """Isotropic total variation, `Σ |∇x|`, with forward differences (Rudin, Osher, Fatemi 1992); rounded."""

    #: The best on the truth was 1 to 3 on eight pictures with 3, 5 and 10 frames.
    scale = 1.6

    def energy(self, value: Tensor) -> Tensor:
        """`Σ weight_map (sqrt(|∇x|² + e²) - e)`, with `e = rounding / weight`."""
        if is_compiled(value):
            energy: Tensor = _CompiledEnergy.apply(value, self.weight_map, float(self.epsilon))
            return energy
        return self.smoothed_l1(squared_gradient(value))

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight weight_map / sqrt(|∇x|² + e²)`, of the gradient."""
        steep = (squared_gradient(value) + self.epsilon.square()).rsqrt()
        return 0.0, float((self.weight * self.weight_map * steep).mean())


class _CompiledEnergy(torch.autograd.Function):
    """The same in one pass, which finds the gradient as well."""

    @staticmethod
    def forward(ctx: Any, value: Tensor, weight_map: Tensor, rounding: float) -> Tensor:
        from deepir.kernels.compile import parallel_for
        from deepir.kernels.gradients import total_variation

        pictures = value.reshape(-1, *value.shape[-2:]).contiguous()
        weight_map = weight_map.to(pictures).expand(pictures.shape[-2:]).contiguous()
        gradient = torch.empty_like(pictures)
        energy = torch.empty(pictures.shape[:-1], dtype=torch.float64)
        for i, picture in enumerate(pictures):
            parallel_for(total_variation, len(picture), picture, weight_map, rounding, energy[i], gradient[i])
        ctx.save_for_backward(gradient.reshape(value.shape))
        return energy.sum()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        (found,) = ctx.saved_tensors
        return gradient.to(found) * found, None, None


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
