"""Sinusoidal representation networks."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Coordinates
from deepir.registry import register


class Sine(nn.Module):
    """A linear layer, then `sin(omega x)`."""

    def __init__(self, inputs: int, outputs: int, omega: float) -> None:
        super().__init__()
        self.omega, self.linear = omega, nn.Linear(inputs, outputs)

    def forward(self, x: Tensor) -> Tensor:
        """`sin(omega (W x + b))`."""
        return torch.sin(self.omega * self.linear(x))


@register("field", "siren")
class Siren(Coordinates):
    """MLP of the coordinates with sine activations (Sitzmann et al. 2020, "Implicit neural representations ...").

    Args:
        shape, neutral: See `Network`.
        width: Of the layers.
        depth: Layers with a sine.
        omega: Factor of each sine's argument.
        options: Those of every `Network`.
    """

    example_options: ClassVar = {"width": 8, "depth": 2}

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        width: int = 256,
        depth: int = 4,
        omega: float = 30.0,
        **options: Any,
    ) -> None:
        super().__init__(shape, neutral, **options)
        check_counts(width=(width, 1024), depth=(depth, 32))
        if not 0 < omega < float("inf"):
            raise ValueError(f"omega must be a positive number, not {omega}")
        layers: list[nn.Module] = [Sine(2 if i == 0 else width, width, omega) for i in range(depth)]
        self.net = nn.Sequential(*layers, nn.Linear(width, shape[0]))
        with torch.no_grad():
            linear = [each for each in self.net.modules() if isinstance(each, nn.Linear)]
            linear[0].weight.uniform_(-1 / 2, 1 / 2)
            for each in linear[1:]:
                bound = (6 / width) ** 0.5 / omega
                each.weight.uniform_(-bound, bound)
        self.begin_at_start(linear[-1])
