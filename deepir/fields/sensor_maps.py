"""Gain and offset as sums of Gaussian parts: columns, rows, single pixels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.registry import register


class GaussianMap(Field):
    """Independent Gaussian values with standard deviation `sigma`, constant along `constant_axes`.

    `sigma` is in the unknown's units (a fraction for a gain, counts for an offset); without it, it is
    estimated from the burst. The parameters are whitened, `value / sigma`, and float64 whatever the output is:
    see `deepir.closed_form.variable_projection`.
    """

    constant_axes: ClassVar[tuple[int, ...]] = ()
    center: Tensor
    sigma: Tensor
    max_sigma: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral)
        if sigma is not None and not (sigma >= 0 and math.isfinite(sigma)):
            raise ValueError(f"sigma must be a number of at least 0, not {sigma}")
        own = [1 if axis - len(shape) in self.constant_axes else side for axis, side in enumerate(shape)]
        self.whitened = nn.Parameter(torch.zeros(own, dtype=torch.float64))
        self.sigma_is_fixed = sigma is not None
        self.register_buffer("center", torch.tensor(float(neutral)))  # neutral, in the output's type
        self.register_buffer("sigma", torch.tensor(0.0 if sigma is None else sigma, dtype=torch.float64))
        # Bound of an estimated sigma.
        self.register_buffer("max_sigma", torch.tensor(math.inf, dtype=torch.float64))

    def forward(self) -> Tensor:
        """`neutral + values`."""
        return (self.neutral + self.values).to(self.center.dtype).expand(self.shape)

    @property
    def prior_sigma(self) -> Tensor:
        """Prior standard deviation of what the whitened values stand for, broadcast against them."""
        return self.sigma

    @property
    def values(self) -> Tensor:
        """The deviation from neutral, float64, of length one along `constant_axes`."""
        return self.prior_sigma * self.whitened

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """The mean along the axes on which the part is constant."""
        deviation = value.to(self.whitened).expand(self.shape) - self.neutral
        self.assign(deviation.mean(self.constant_axes, keepdim=True) if self.constant_axes else deviation)

    @torch.no_grad()
    def assign(self, values: Tensor) -> None:
        """Set the deviation from neutral; a part whose sigma is zero stays zero."""
        self.whitened.copy_(values / self.sigma if self.sigma > 0 else torch.zeros_like(values))

    def map_variance(self, variance: Tensor) -> Tensor:
        """Variance of the map, (1, 1, h or 1, w or 1), for that of what the whitened values stand for."""
        return variance

    def penalty(self) -> Tensor:
        """`½ Σ values² / sigma²`."""
        whitened = self.whitened.flatten()
        return torch.dot(whitened, whitened) / 2

    def parts(self) -> Sequence[GaussianMap]:
        """The part itself."""
        return (self,)

    @classmethod
    def example(cls) -> GaussianMap:
        """A map of 6 x 7 px."""
        return cls((1, 1, 6, 7), 1.0, sigma=0.1)


@register("field", "column")
class Column(GaussianMap):
    """One value for each column: the readout amplifiers."""

    constant_axes = (-2,)


@register("field", "row")
class Row(GaussianMap):
    """One value for each row."""

    constant_axes = (-1,)


@register("field", "pixel")
class Pixel(GaussianMap):
    """One value for each pixel, with a Gaussian prior."""


class SumField(Field):
    """The sum of several fields, `column+row+pixel` in a configuration; options go by the part's name."""

    def __init__(self, shape: Shape, neutral: float, members: dict[str, Field]) -> None:
        super().__init__(shape, neutral)
        self.members = nn.ModuleDict(members)

    def forward(self) -> Tensor:
        """`neutral + Σ members`: of parts, in float64, the shortest first."""
        if parts := self.parts():
            first, *others = sorted((part.values for part in parts), key=Tensor.numel)
            values = functools.reduce(torch.add, others, self.neutral + first)
            return values.to(parts[0].center.dtype).expand(self.shape)
        return functools.reduce(torch.add, (member() for member in self.members.values())) + self.neutral

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Give each member, in turn, what those before it left."""
        rest = value.expand(self.shape) - self.neutral
        for member in self.members.values():
            member.init_from(rest)  # type: ignore[operator]
            rest = rest - member().to(rest)

    def penalty(self) -> Tensor | None:
        """The sum of the members' own."""
        found = [p for member in self.members.values() if (p := member.penalty()) is not None]  # type: ignore[operator]
        return functools.reduce(torch.add, found) if found else None

    def parts(self) -> Sequence[GaussianMap]:
        """All parts, if every member is made of parts; otherwise none: the sum has no closed form."""
        each = [member.parts() for member in self.members.values()]  # type: ignore[operator]
        return [part for parts in each for part in parts] if all(each) else ()
