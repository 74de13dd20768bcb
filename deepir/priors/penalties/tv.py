"""Penalties of differences: their squares, and total variation of first and second order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Shape, check_positive
from deepir.kernels.threads import is_compiled
from deepir.priors.penalties.base import Penalty, SpatiallyWeighted
from deepir.registry import register

#: Typical gradient, noise standard deviations; 4 to 11 were best on bursts and a blurred frame with known truth.
GRADIENT_SIGMA_RATIO = 5.0


@register("penalty", "smooth")
class Tikhonov(Penalty):
    """Half the sum of squared gradients, `½ Σ |∇x|²`: shading, drift across the array (Tikhonov 1963)."""

    def energy(self, value: Tensor) -> Tensor:
        """`½ Σ |∇x|²`, with forward differences."""
        return squared_gradient(value).sum(dtype=torch.float64) / 2

    def default_weight(self, sigma: float) -> float:
        """Inverse variance of a gradient of `GRADIENT_SIGMA_RATIO` noise standard deviations."""
        return 1 / (GRADIENT_SIGMA_RATIO * sigma) ** 2

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The weight, of the gradient."""
        return 0.0, float(self.weight)


class CompiledEnergy(torch.autograd.Function):
    """An energy of a value, in one pass of a compiled loop over the rows, which finds the gradient as well.

    `loop(first, last, picture, weight_map, *options, energy, gradient)`: see `deepir.kernels.gradients`.
    """

    @staticmethod
    def forward(
        ctx: Any, value: Tensor, weight_map: Tensor, loop: Callable[..., None], *options: Tensor | float
    ) -> Tensor:
        """The energy of a value (..., H, W), a float64 scalar."""
        from deepir.kernels.compile import parallel_for

        pictures = value.reshape(-1, *value.shape[-2:]).contiguous()
        weight_map = weight_map.to(pictures).expand(pictures.shape[-2:]).contiguous()
        given = [each.to(pictures).contiguous() if isinstance(each, Tensor) else each for each in options]
        gradient = torch.empty_like(pictures)
        energy = torch.empty(pictures.shape[:-1], dtype=torch.float64)
        for i, picture in enumerate(pictures):
            parallel_for(loop, len(picture), picture, weight_map, *given, energy[i], gradient[i])
        ctx.save_for_backward(gradient.reshape(value.shape))
        return energy.sum()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        """The gradient in the value alone."""
        (found,) = ctx.saved_tensors
        return gradient.to(found) * found, *(None for _ in ctx.needs_input_grad[1:])


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

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None, rounding: float = 0.1) -> None:
        super().__init__(shape, weight=weight)
        check_positive(rounding=rounding)
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

    scale = 1.6  # the best on the truth was 1 to 3 on eight pictures with 3, 5 and 10 frames

    def energy(self, value: Tensor) -> Tensor:
        """`Σ weight_map (sqrt(|∇x|² + e²) - e)`, with `e = rounding / weight`."""
        if is_compiled(value):
            from deepir.kernels.gradients import total_variation

            energy: Tensor = CompiledEnergy.apply(value, self.weight_map, total_variation, float(self.epsilon))
            return energy
        return self.smoothed_l1(squared_gradient(value))

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight weight_map / sqrt(|∇x|² + e²)`, of the gradient."""
        steep = (squared_gradient(value) + self.epsilon.square()).rsqrt()
        return 0.0, float((self.weight * self.weight_map * steep).mean())


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


@register("penalty", "huber_tv")
class HuberTV(SpatiallyWeighted):
    """Huber's function of `|∇x|`: quadratic up to `threshold`, in units of `1 / weight`, linear beyond.

    It makes no stairs of slopes, as TV does (Werlberger et al. 2009, "Anisotropic Huber-L1 optical flow").
    """

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None, threshold: float = 1.0) -> None:
        super().__init__(shape, weight=weight)
        check_positive(threshold=threshold)
        self.threshold = threshold

    def energy(self, value: Tensor) -> Tensor:
        """`|∇x|² / 2 d` where `|∇x| < d = threshold / weight`, `|∇x| - d / 2` elsewhere, summed by `weight_map`."""
        d = self.threshold / self.weight.clamp(min=1e-12)
        squared = squared_gradient(value)
        linear = squared.clamp(min=d.square().to(squared)).sqrt() - d / 2
        return (self.weight_map * torch.where(squared < d.square(), squared / (2 * d), linear)).sum(dtype=torch.float64)

    def default_weight(self, sigma: float) -> float:
        """One nat for a step of `TV.scale` standard deviations."""
        return 1 / (TV.scale * sigma)

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight weight_map / max(|∇x|, d)`, of the gradient."""
        d = self.threshold / self.weight.clamp(min=1e-12)
        steep = squared_gradient(value).sqrt().clamp(min=float(d))
        return 0.0, float((self.weight * self.weight_map / steep).mean())


@register("penalty", "tgv")
class TGV(SmoothedNorm):
    """The least, over all slopes w, of `Σ |∇x - w| + ratio |∇w|`: edges and kinks cost, slopes do not.

    (Bredies, Kunisch, Pock 2010, "Total generalized variation", second order, with the symmetrised gradient of w.) The
    slopes are unknowns of the penalty, found along with the value. Rounded as total variation is.
    """

    scale = 1.6  # as for total variation
    adapts = False  # not tested with a weight map
    unit: Tensor

    def __init__(self, shape: Shape, *, weight: float | None = None, ratio: float = 1.0, rounding: float = 0.1) -> None:
        super().__init__(shape, weight=weight, rounding=rounding)
        check_positive(ratio=ratio)
        self.ratio = ratio
        #: Along y and x, in the unit: the value's spread, so that they move as its pixels do.
        self.slopes = nn.Parameter(torch.zeros(2, *shape))
        self.register_buffer("unit", torch.tensor(1.0))

    def energy(self, value: Tensor) -> Tensor:
        """`Σ |∇x - w| + ratio |E w|` at the slopes as they are."""
        down, right = self.unit * self.slopes
        edges = (_down(value) - down).square() + (_right(value) - right).square()
        shear = _right(down) + _down(right)
        kinks = _down(down).square() + _right(right).square() + shear.square() / 2
        return self.smoothed_l1(edges) + self.ratio * self.smoothed_l1(kinks)

    def adapt(self, value: Tensor, noise: float) -> None:
        """Take the spread of the value for the slopes' unit."""
        spread = value.std().clamp(min=1e-30)
        self.slopes.mul_(self.unit / spread)
        self.unit.copy_(spread)

    @classmethod
    def example(cls, **options: Any) -> TGV:
        """For a value of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)


def _down(x: Tensor) -> Tensor:
    return x.diff(dim=-2, append=x[..., -1:, :])


def _right(x: Tensor) -> Tensor:
    return x.diff(dim=-1, append=x[..., :, -1:])
