"""Random Fourier features."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Coordinates
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
        shape, neutral: See `Network`.
        count: Of the waves.
        bandwidth: Standard deviation of the waves' frequencies, in periods over the scene's longer side.
        width: Of the layers.
        depth: Layers with a rectifier.
        options: Those of every `Network`.
    """

    example_options: ClassVar = {"count": 4, "width": 8, "depth": 1}

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        count: int = 256,
        bandwidth: float = 10.0,
        width: int = 256,
        depth: int = 3,
        **options: Any,
    ) -> None:
        super().__init__(shape, neutral, **options)
        check_counts(count=(count, 4096), width=(width, 1024), depth=(depth, 32))
        if not 0 < bandwidth < float("inf"):
            raise ValueError(f"bandwidth must be a positive number, not {bandwidth}")
        layers: list[nn.Module] = [Waves(count, bandwidth)]
        for i in range(depth):
            layers += [nn.Linear(2 * count if i == 0 else width, width), nn.ReLU()]
        last = nn.Linear(width, shape[0])
        self.begin_at_start(last)
        self.net = nn.Sequential(*layers, last)
