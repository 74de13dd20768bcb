"""Total variation that leaves small gradients smooth."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Shape
from deepir.priors.penalties.base import SpatiallyWeighted
from deepir.priors.penalties.tv import TV
from deepir.registry import register


@register("penalty", "huber_tv")
class HuberTV(SpatiallyWeighted):
    """Huber's function of `|∇x|`: quadratic up to `threshold`, in units of `1 / weight`, linear beyond.

    It makes no stairs of slopes, as TV does (Werlberger et al. 2009, "Anisotropic Huber-L1 optical flow").
    """

    def __init__(
        self, shape: Shape | None = None, *, weight: float | None = None, threshold: float = 1.0
    ) -> None:
        super().__init__(shape, weight=weight)
        if not 0 < threshold < float("inf"):
            raise ValueError(f"threshold must be a positive number, not {threshold}")
        self.threshold = threshold

    def energy(self, value: Tensor) -> Tensor:
        """`|∇x|² / 2 d` where `|∇x| < d = threshold / weight`, `|∇x| - d / 2` elsewhere, summed by `weight_map`."""
        d = self.threshold / self.weight.clamp(min=1e-12)
        squared = squared_gradient(value)
        linear = squared.clamp(min=d.square().to(squared)).sqrt() - d / 2
        return (self.weight_map * torch.where(squared < d.square(), squared / (2 * d), linear)).sum(
            dtype=torch.float64
        )

    def default_weight(self, sigma: float) -> float:
        """One nat for a step of `TV.scale` standard deviations."""
        return 1 / (TV.scale * sigma)

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """The mean of `weight weight_map / max(|∇x|, d)`, of the gradient."""
        d = self.threshold / self.weight.clamp(min=1e-12)
        steep = squared_gradient(value).sqrt().clamp(min=float(d))
        return 0.0, float((self.weight * self.weight_map / steep).mean())
