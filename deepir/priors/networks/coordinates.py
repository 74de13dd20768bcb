"""Base class of implicit neural representations."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.priors.networks.base import Network


class Coordinates(Network):
    """Implicit representation `net((x, y)) -> values`, with coordinates from -1 to 1 along the longer side.

    The network has one output for each of the S scenes.
    """

    net: nn.Module
    points: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, **options: Any) -> None:
        super().__init__(shape, neutral, **options)
        far = max(*shape[-2:], 2) - 1
        y, x = (torch.arange(side) * 2 - (side - 1) for side in shape[-2:])
        grid = torch.stack(torch.meshgrid(x / far, y / far, indexing="xy"), -1)
        self.register_buffer("points", grid.flatten(0, 1))

    def draw(self) -> Tensor:
        """The network at all pixels."""
        return self.at(self.points).T.reshape(-1, 1, *self.shape[-2:])

    def at(self, points: Tensor) -> Tensor:
        """The network at points (n, 2), as (x, y): (n, S), in units of the scene's spread."""
        value: Tensor = self.net(points)
        return value
