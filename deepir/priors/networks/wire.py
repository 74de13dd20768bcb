"""Wavelet representation networks."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Coordinates
from deepir.registry import register


class Gabor(nn.Module):
    """A complex linear layer, then `exp(j omega z - |s z|²)`; real and imaginary parts lie side by side."""

    def __init__(
        self, inputs: int, outputs: int, omega: float, sharpness: float, *, real: bool = False
    ) -> None:
        super().__init__()
        self.omega, self.sharpness, self.real = omega, sharpness, real
        self.linear = nn.Linear(inputs, outputs if real else 2 * outputs)

    def forward(self, x: Tensor) -> Tensor:
        """(n, inputs) if `real`, else (n, 2 inputs) -> (n, 2 outputs)."""
        re, im = self._transformed(x)
        size = torch.exp(-self.omega * im - self.sharpness**2 * (re.square() + im.square()))
        phase = self.omega * re
        return torch.cat((size * phase.cos(), size * phase.sin()), -1)

    def _transformed(self, x: Tensor) -> tuple[Tensor, Tensor]:
        if self.real:
            re: Tensor = self.linear(x)
            return re, torch.zeros_like(re)
        a, b = x.chunk(2, -1)
        real, imaginary = self.linear.weight.chunk(2)  # of the matrix
        bias_re, bias_im = self.linear.bias.chunk(2)
        return a @ real.T - b @ imaginary.T + bias_re, a @ imaginary.T + b @ real.T + bias_im


@register("field", "wire")
class Wire(Coordinates):
    """MLP of the coordinates with complex Gabor activations (Saragadam et al. 2023, "WIRE").

    Args:
        shape, neutral: See `Network`.
        width: Complex units of the layers.
        depth: Layers with a wavelet after the first.
        omega: Frequency of the wavelets.
        sharpness: One over their width.
        options: Those of every `Network`.
    """

    example_options: ClassVar = {"width": 4, "depth": 1}

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        width: int = 181,
        depth: int = 2,
        omega: float = 10.0,
        sharpness: float = 10.0,
        **options: Any,
    ) -> None:
        super().__init__(shape, neutral, **options)
        check_counts(width=(width, 1024), depth=(depth, 32))
        if not (0 < omega < float("inf") and 0 <= sharpness < float("inf")):
            raise ValueError("omega must be positive and sharpness not negative")
        first = Gabor(2, width, omega, sharpness, real=True)
        inner = [Gabor(width, width, omega, sharpness) for _ in range(depth)]
        last = nn.Linear(2 * width, shape[0])  # the real part of a complex one
        nn.init.uniform_(last.weight, -(width**-0.5), width**-0.5)
        self.begin_at_start(last)
        self.net = nn.Sequential(first, *inner, last)
