"""Gain and offset as sums of Gaussian maps: columns, rows, pixels."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape, demand_deviation
from deepir.registry import register


class GaussianMap(Field):
    """Independent Gaussian values, constant along `constant_axes`.

    Parameters are whitened, `value / sigma`, and float64: see `deepir.closed_form.variable_projection`.

    Args:
        shape: (1, 1, h, w).
        neutral: Value that leaves the data unchanged.
        sigma: Prior standard deviation, units of the unknown (1 for a gain, data units for an offset); estimated if
            None.

    Raises:
        ValueError: `sigma` is negative or not finite.
    """

    example_options: ClassVar = {"neutral": 1.0, "sigma": 0.1}
    constant_axes: ClassVar[tuple[int, ...]] = ()
    center: Tensor
    sigma: Tensor
    max_sigma: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral)
        demand_deviation(sigma)
        own = [1 if axis - len(shape) in self.constant_axes else side for axis, side in enumerate(shape)]
        self.whitened = nn.Parameter(torch.zeros(own, dtype=torch.float64))
        self.sigma_is_fixed = sigma is not None
        self.register_buffer("center", torch.tensor(float(neutral)))  # neutral, in the output's type
        self.register_buffer("sigma", torch.tensor(0.0 if sigma is None else sigma, dtype=torch.float64))
        # Upper bound of an estimated sigma.
        self.register_buffer("max_sigma", torch.tensor(math.inf, dtype=torch.float64))

    def forward(self) -> Tensor:
        """`neutral + values`."""
        return (self.neutral + self.values).to(self.center.dtype).expand(self.shape)

    @property
    def prior_sigma(self) -> Tensor:
        """Prior standard deviation of the values, broadcast against the whitened ones."""
        return self.sigma

    @property
    def values(self) -> Tensor:
        """Deviation from neutral, float64, of length one along `constant_axes`."""
        return self.prior_sigma * self.whitened

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent the mean along `constant_axes`."""
        deviation = value.to(self.whitened).expand(self.shape) - self.neutral
        self.assign(deviation.mean(self.constant_axes, keepdim=True) if self.constant_axes else deviation)

    @torch.no_grad()
    def assign(self, values: Tensor) -> None:
        """Set the deviation from neutral; zero if sigma is zero."""
        self.whitened.copy_(values / self.sigma if self.sigma > 0 else torch.zeros_like(values))

    def map_variance(self, variance: Tensor) -> Tensor:
        """Variance of the map, (1, 1, h or 1, w or 1), from the variances of the values."""
        return variance

    def penalty(self) -> Tensor:
        """`½ Σ values² / sigma²`."""
        whitened = self.whitened.flatten()
        return torch.dot(whitened, whitened) / 2

    def parts(self) -> Sequence[GaussianMap]:
        """The part itself."""
        return (self,)


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
    """Sum of fields, `column+row+pixel` in a configuration; options are given by member."""

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
        """Initialise the members in turn, each from the remainder of those before."""
        rest = value.expand(self.shape) - self.neutral
        for member in self.members.values():
            member.init_from(rest)  # type: ignore[operator]
            rest = rest - member().to(rest)

    def penalty(self) -> Tensor | None:
        """The sum of the members' own."""
        found = [p for member in self.members.values() if (p := member.penalty()) is not None]  # type: ignore[operator]
        return functools.reduce(torch.add, found) if found else None

    def parts(self) -> Sequence[GaussianMap]:
        """Gaussian maps of all members; () if a member has none, as the sum then has no closed form."""
        each = [member.parts() for member in self.members.values()]  # type: ignore[operator]
        return [part for parts in each for part in parts] if all(each) else ()
