"""Fields of experts."""

from __future__ import annotations

import functools

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir import weights
from deepir.fields.base import Shape
from deepir.kernels.threads import is_compiled
from deepir.priors.penalties.tv import CompiledEnergy, SmoothedNorm
from deepir.registry import register

FILTER_SIDE = 5  # side of a filter, px
#: Initial filters of training: first, diagonal, second and mixed differences.
INITIAL_FILTERS = (
    ((0, 0, 0), (0, -1, 1), (0, 0, 0)),
    ((0, 0, 0), (0, -1, 0), (0, 1, 0)),
    ((0, 0, 0), (0, -1, 0), (0, 0, 1)),
    ((0, 0, 0), (0, -1, 0), (1, 0, 0)),
    ((0, 0, 0), (1, -2, 1), (0, 0, 0)),
    ((0, 1, 0), (0, -2, 0), (0, 1, 0)),
    ((0, 0, 0), (0, 1, -1), (0, -1, 1)),
    ((1, -2, 1), (-2, 4, -2), (1, -2, 1)),
)
SAMPLING_STRIDE = 3  # stride at which responses are sampled for statistics, px
FLAT_RESPONSE = 0.3  # response below which a filter counts as flat, noise standard deviations


class Experts(nn.Module):
    """Parameters of the experts: filters, weights and tails; trained by `deepir train foe`."""

    def __init__(self) -> None:
        super().__init__()
        start = F.pad(torch.tensor(INITIAL_FILTERS, dtype=torch.float32), (1, 1, 1, 1))
        self.taps = nn.Parameter(start + 0.03 * torch.randn(start.shape))
        self.costs = nn.Parameter(torch.full((len(start),), -1.6))
        self.tails = nn.Parameter(torch.full((len(start),), 1.8))

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """Filters (C, k, k) of zero mean and the norm of a difference; weights (C,); tails (C,)."""
        taps = self.taps - self.taps.mean((1, 2), keepdim=True)
        filters = taps * (2 / taps.square().sum((1, 2), keepdim=True)).sqrt()
        return filters, self.costs.exp(), self.tails.exp()


@register("penalty", "foe")
class FoE(SmoothedNorm):
    """Fields of experts, `Σ w_c φ(f_c * x)`: heavy-tailed costs φ of the responses of small learned filters.

    Fine texture and slopes cost less than with total variation.

    Source: Roth and Black 2009, "Fields of experts"; trained so that the minimum is the best estimate, Samuel and
    Tappen 2009, "Learning optimized MAP estimates in continuously-valued MRF models".
    """

    scale = 1.0  # the experts are in units of the noise
    smooth_scene_threshold = 2.0  # skies: the filters model noise better than edges
    filters: Tensor
    costs: Tensor
    tails: Tensor

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None, rounding: float = 0.09) -> None:
        super().__init__(shape, weight=weight, rounding=rounding)
        for name, value in zip(("filters", "costs", "tails"), _shipped()(), strict=True):
            self.register_buffer(name, value.clone(), persistent=False)

    def energy(self, value: Tensor) -> Tensor:
        """`Σ m Σ_c w_c 2 t_c (sqrt(1 + l / t_c) - 1)`, `l = sqrt((f_c * x)² + e²) - e`, with the weight map m.

        Lengths are in units of `1 / weight`. The cost is linear in small `l`, like total variation, and grows as the
        square root of large `l`.
        """
        tails = self.tails / self.weight.clamp(min=1e-12)
        if is_compiled(value):
            from deepir.kernels.gradients import experts

            learned = (self.filters, self.costs, tails)
            energy: Tensor = CompiledEnergy.apply(value, self.weight_map, experts, *learned, float(self.epsilon))
            return energy
        return foe_energy(value, self.weight_map, self.filters, self.costs, tails, self.epsilon)

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight weight_map Σ w_c |f_c|² φ' / 4 |f_c * x|`: a filter's share of the gradient's waves."""
        long = filter_magnitudes(value, self.filters, self.epsilon, SAMPLING_STRIDE)
        bent = (1 + long * (self.weight / self.tails)[:, None, None]).rsqrt() / (long + self.epsilon)
        stiff = central_weights(self.weight_map, value.shape)[..., ::SAMPLING_STRIDE, ::SAMPLING_STRIDE] * (
            self.costs[:, None, None] * bent
        )
        return 0.0, float(self.weight * stiff.mean((-2, -1)).sum(-1).mean() / 2)  # |f_c|² is two

    def fraction_shrunk_to_zero(self, value: Tensor) -> float:
        """Fraction of the filter responses below `FLAT_RESPONSE`."""
        long = filter_magnitudes(value, self.filters, self.epsilon, SAMPLING_STRIDE)
        return float((long * self.weight < FLAT_RESPONSE).float().mean())


def foe_energy(
    value: Tensor, weight_map: Tensor, filters: Tensor, costs: Tensor, tails: Tensor, epsilon: Tensor | float
) -> Tensor:
    """Energy of `FoE` in torch, with gradients in all arguments.

    Args:
        value: (..., H, W).
        weight_map: (..., H, W), or a scalar.
        filters: (C, FILTER_SIDE, FILTER_SIDE).
        costs: Weight w_c of each filter, (C,).
        tails: Response t_c above which the cost grows as a square root, (C,), units of the value.
        epsilon: Smoothing length e, units of the value.

    Returns:
        A float64 scalar.
    """
    long = filter_magnitudes(value, filters, epsilon)
    tails, costs = (each[:, None, None].to(long) for each in (tails, costs))
    each = costs * 2 * long / (1 + (1 + long / tails).sqrt())
    return (central_weights(weight_map, value.shape) * each).sum(dtype=torch.float64)


def filter_magnitudes(value: Tensor, filters: Tensor, epsilon: Tensor | float, step: int = 1) -> Tensor:
    """`sqrt((f_c * x)² + e²) - e`, (..., C, H - 4, W - 4), without its cancellation."""
    flat = value.reshape(-1, 1, *value.shape[-2:])
    squared = F.conv2d(flat, filters[:, None].to(flat), stride=step).square()
    long = squared / ((squared + epsilon**2).sqrt() + epsilon)
    return long.reshape(*value.shape[:-2], *long.shape[1:])


def central_weights(weight_map: Tensor, shape: Shape) -> Tensor:
    """Weights of the pixels at which a filter lies inside the image, (..., 1, H - 4, W - 4)."""
    inside = slice(FILTER_SIDE // 2, -(FILTER_SIDE // 2))
    return weight_map.expand(*weight_map.shape[:-2], *shape[-2:])[..., None, inside, inside]


@functools.cache
def _shipped() -> Experts:
    return weights.load(Experts(), weights.SHIPPED / "foe.safetensors")
