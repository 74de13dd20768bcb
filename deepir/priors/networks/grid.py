"""Grids of several resolutions."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Network
from deepir.registry import register

INITIAL_FEATURE_SIGMA = 1e-2  # initial standard deviation of the features


@register("field", "grid")
class Grid(Network):
    """Features on dense grids, each twice as coarse as the one before, and a small network that mixes them.

    (After Müller et al. 2022, "Instant neural graphics primitives"; dense, as a scene has few pixels.) Scenes have
    grids of their own, and share the small network.

    Args:
        shape, neutral: See `Network`.
        levels: Of resolution, the first that of the scene.
        features: Of each grid's nodes.
        width: Of the mixing network.
        options: Those of every `Network`.
    """

    example_options: ClassVar = {"levels": 2, "features": 2, "width": 4}

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, levels: int = 5, features: int = 4, width: int = 16, **options: Any
    ) -> None:
        super().__init__(shape, neutral, **options)
        check_counts(levels=(levels, 16), features=(features, 64), width=(width, 1024))
        sizes = [[max(-(-side // 2**level), 2) for side in shape[-2:]] for level in range(levels)]
        sizes[0] = list(shape[-2:])
        self.grids = nn.ParameterList(
            nn.Parameter(INITIAL_FEATURE_SIGMA * torch.randn(shape[0], features, *size)) for size in sizes
        )
        self.mix = nn.Sequential(
            nn.Conv2d(levels * features, width, 1), nn.GELU(), nn.Conv2d(width, width, 1), nn.GELU()
        )
        self.last = nn.Conv2d(width, 1, 1)
        self.begin_at_start(self.last)

    def draw(self) -> Tensor:
        """The grids, interpolated and mixed."""
        finest, *coarse = self.grids
        size = list(self.shape[-2:])
        each = [F.interpolate(grid, size=size, mode="bicubic", align_corners=True) for grid in coarse]
        picture: Tensor = self.last(self.mix(torch.cat((finest, *each), 1)))
        return picture
