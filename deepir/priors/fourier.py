"""Random Fourier features."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from deepir.priors.coordinates import Coordinates
from deepir.priors.field import Shape
from deepir.registry import register


class Waves(nn.Module):
    """Sines and cosines of random frequencies, which are Gaussian and stay as they are."""

    frequencies: Tensor

    def __init__(self, count: int, bandwidth: float) -> None:
        super().__init__()
        self.register_buffer("frequencies", bandwidth * torch.randn(2, count))

    def forward(self, points: Tensor) -> Tensor:
        """Points (n, 2) -> (n, 2 count)."""
        # The coordinates of the published ones go from 0 to 1.
        phase = math.pi * points @ self.frequencies
        return torch.cat((phase.sin(), phase.cos()), -1)


@register("field", "fourier")
class Fourier(Coordinates):
    """Rectified layers over random waves (Tancik et al. 2020, "Fourier features let networks learn ...").

    Args:
        shape: Of the scene, (S, 1, H, W).
        neutral: The level, until it starts somewhere.
        count: Of the waves.
        bandwidth: Standard deviation of the waves' frequencies, in periods over the scene's longer side.
        width: Of the layers.
        depth: Layers with a rectifier.
        residual: Whether it draws what is added to what the scene starts at.
        bf16: Whether layers are computed in bfloat16.
    """

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        count: int = 256,
        bandwidth: float = 10.0,
        width: int = 256,
        depth: int = 3,
        residual: bool = False,
        bf16: bool = False,
    ) -> None:
        super().__init__(shape, neutral, residual=residual, bf16=bf16)
        if min(count, width, depth) < 1 or not 0 < bandwidth < float("inf"):
            raise ValueError("count, width and depth must be at least 1, and bandwidth a positive number")
        layers: list[nn.Module] = [Waves(count, bandwidth)]
        for i in range(depth):
            layers += [nn.Linear(2 * count if i == 0 else width, width), nn.ReLU()]
        last = nn.Linear(width, shape[0])
        if residual:  # it begins at what it starts from
            nn.init.zeros_(last.weight)
            nn.init.zeros_(last.bias)
        self.net = nn.Sequential(*layers, last)

    @classmethod
    def example(cls) -> Fourier:
        """A small one for 6 x 7 px."""
        return cls((1, 1, 6, 7), count=4, width=8, depth=1)
