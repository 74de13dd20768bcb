"""Implicit representations, networks of the coordinates: sines (SIREN), wavelets (WIRE), Fourier features, grids."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts, check_positive
from deepir.priors.networks.base import Network
from deepir.registry import register

INITIAL_FEATURE_SIGMA = 1e-2  # initial standard deviation of the features


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
        value: Tensor = self.net(self.points)
        return value.T.reshape(-1, 1, *self.shape[-2:])


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
        check_positive(omega=omega)
        layers: list[nn.Module] = [Sine(2 if i == 0 else width, width, omega) for i in range(depth)]
        self.net = nn.Sequential(*layers, nn.Linear(width, shape[0]))
        with torch.no_grad():
            linear = [each for each in self.net.modules() if isinstance(each, nn.Linear)]
            linear[0].weight.uniform_(-1 / 2, 1 / 2)
            for each in linear[1:]:
                bound = (6 / width) ** 0.5 / omega
                each.weight.uniform_(-bound, bound)
        self.begin_at_start(linear[-1])


class Gabor(nn.Module):
    """A complex linear layer, then `exp(j omega z - |s z|²)`; real and imaginary parts lie side by side."""

    def __init__(self, inputs: int, outputs: int, omega: float, sharpness: float, *, real: bool = False) -> None:
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
        check_positive(bandwidth=bandwidth)
        layers: list[nn.Module] = [Waves(count, bandwidth)]
        for i in range(depth):
            layers += [nn.Linear(2 * count if i == 0 else width, width), nn.ReLU()]
        last = nn.Linear(width, shape[0])
        self.begin_at_start(last)
        self.net = nn.Sequential(*layers, last)


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
