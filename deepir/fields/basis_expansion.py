"""Maps in a small linear basis: cosines over the frame, a radial profile."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import GaussianField, Shape, check_counts
from deepir.registry import register


class BasisExpansion(GaussianField):
    """`neutral + Σ a_i t_i` over the frame, with zero-mean terms t_i and Gaussian coefficients a_i.

    A subclass defines the terms, waves of mean square `1 / frequency⁴`: the prior is the bending energy `½ Σ |Δ s|²`.

    Args:
        shape: (1, 1, h, w).
        neutral: Value that leaves the data unchanged.
        frequency: Of each term, half waves over the longer side, (terms,).
        sigma: Standard deviation of the coefficients, data units; estimated if None. Zero: the map is neutral.
    """

    frequency: Tensor

    def __init__(self, shape: Shape, neutral: float, frequency: Tensor, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral, sigma=sigma)
        self.register_buffer("frequency", frequency, persistent=False)
        self.values = nn.Parameter(torch.zeros(len(frequency)))

    def synthesise(self, coefficients: Tensor) -> Tensor:
        """The map (h, w) of coefficients (terms,)."""
        raise NotImplementedError

    @property
    def coefficients(self) -> Tensor:
        """The a_i, (terms,)."""
        return self.preconditioning_scale * (self.sigma > 0) * self.values

    def forward(self) -> Tensor:
        """The map, (1, 1, h, w)."""
        return (self.neutral + self.synthesise(self.coefficients)).expand(self.shape)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """The nearest map, in the least squares sense."""
        rest = (value.to(self.values).expand(self.shape) - self.neutral).flatten()
        terms = self.sample_basis().flatten(1)
        gram = torch.linalg.pinv(terms @ terms.T, hermitian=True)
        self.values.copy_(gram @ (terms @ (rest - rest.mean())) / self.preconditioning_scale)

    def sample_basis(self, step_y: int = 1, step_x: int = 1) -> Tensor:
        """All terms at every step-th pixel, (terms, h / step_y, w / step_x)."""
        one = torch.eye(len(self.values), dtype=self.values.dtype, device=self.values.device)
        return torch.stack([self.synthesise(each)[::step_y, ::step_x] for each in one])


@register("field", "dct")
class DCT(BasisExpansion):
    """Cosines of up to `order` half waves over the longer side, without the constant: a smooth map."""

    example_options: ClassVar = {"order": 3, "sigma": 0.1}
    basis_y: Tensor
    basis_x: Tensor
    order_y: Tensor
    order_x: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, order: int = 20, sigma: float | None = None) -> None:
        check_counts(order=(order, 1000))
        height, width = shape[-2:]
        longer = max(height, width)
        y, x = torch.meshgrid(
            torch.arange(min(order + 1, height)) * longer / height,
            torch.arange(min(order + 1, width)) * longer / width,
            indexing="ij",
        )
        frequency = torch.hypot(y, x)
        kept = (frequency > 0) & (frequency <= order)
        super().__init__(shape, neutral, frequency[kept], sigma=sigma)
        self.register_buffer("order_y", kept.nonzero()[:, 0], persistent=False)
        self.register_buffer("order_x", kept.nonzero()[:, 1], persistent=False)
        for name, side, count in (("basis_y", height, y.shape[0]), ("basis_x", width, x.shape[1])):
            self.register_buffer(name, _cosines(side, count), persistent=False)

    def synthesise(self, coefficients: Tensor) -> Tensor:
        """Products of cosines along y and x."""
        table = coefficients.new_zeros(len(self.basis_y), len(self.basis_x))
        sized = coefficients / self.frequency.to(coefficients).square()
        table = table.index_put((self.order_y, self.order_x), sized)
        return self.basis_y.T.to(table) @ table @ self.basis_x.to(table)

    def sample_basis(self, step_y: int = 1, step_x: int = 1) -> Tensor:
        """All terms at every step-th pixel, (terms, h / step_y, w / step_x)."""
        y, x = self.basis_y[self.order_y, ::step_y], self.basis_x[self.order_x, ::step_x]
        return (y / self.frequency[:, None].square())[..., None] * x[:, None]

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """The nearest map: the cosines are orthogonal."""
        rest = (value.to(self.values).expand(self.shape) - self.neutral)[0, 0]
        table = self.basis_y.to(rest) @ rest @ self.basis_x.T.to(rest) / rest.numel()
        self.values.copy_(table[self.order_y, self.order_x] * self.frequency.square() / self.preconditioning_scale)


def _cosines(side: int, count: int) -> Tensor:
    """(count, side), of mean square one."""
    at = torch.pi * (torch.arange(side, dtype=torch.float64) + 0.5) / side
    waves = 2**0.5 * torch.cos(torch.arange(count)[:, None] * at)
    waves[0] = 1
    return waves.float()


@register("field", "radial")
class Radial(BasisExpansion):
    """Radial profile about a centre: cosines of up to `order` half waves of the radius.

    Reflections of a lens are symmetric about its axis: a spot, a ring, darker corners.

    Args:
        shape: (1, 1, h, w).
        neutral: Value that leaves the data unchanged.
        order: Largest number of half waves.
        centre: (y, x), px from the centre of the frame.
        sigma: Standard deviation of the coefficients, data units; estimated if None.
    """

    example_options: ClassVar = {"order": 3, "centre": (0.5, -1.0), "sigma": 0.1}
    profile: Tensor
    radius_index: Tensor
    radius_fraction: Tensor

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        order: int = 20,
        centre: tuple[float, float] = (0.0, 0.0),
        sigma: float | None = None,
    ) -> None:
        check_counts(order=(order, 1000))
        y, x = (torch.arange(side) - (side - 1) / 2 - at for side, at in zip(shape[-2:], centre, strict=True))
        radius = torch.hypot(y[:, None], x)
        count = int(radius.max()) + 2
        super().__init__(shape, neutral, torch.arange(1, order + 1) * max(shape[-2:]) / count, sigma=sigma)
        self.register_buffer("radius_index", radius.long(), persistent=False)
        self.register_buffer("radius_fraction", radius - radius.floor(), persistent=False)
        waves = _cosines(count, order + 1)[1:] / self.frequency[:, None].square()
        self.register_buffer("profile", waves, persistent=False)

    def synthesise(self, coefficients: Tensor) -> Tensor:
        """The profile, interpolated linearly between whole radii, less its mean."""
        profile = coefficients @ self.profile.to(coefficients)
        found = torch.lerp(profile[self.radius_index], profile[self.radius_index + 1], self.radius_fraction.to(profile))
        return found - found.mean()
