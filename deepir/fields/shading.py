"""Shading: the smooth part of gain and offset, from the optics and the housing."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, counted
from deepir.fields.sensor_maps import Part
from deepir.registry import register

DECAY = 0.1  # of the variance of a term, from a degree to the next


@register("field", "shading")
class Shading(Part):
    """A polynomial over the frame, without a constant; `sigma` is that of each of its two slopes, root mean square.

    The terms are products of Legendre polynomials in y and x, orthogonal over the pixels, of a total degree up to
    `degree`: what optics and housing do is mostly a slope and a bowl, and each degree has a tenth of the variance of
    the one before.
    """

    #: The polynomials along each axis, (degree + 1, side), what powers they are made of, and which of them each term
    #: has, (terms,).
    in_y: Tensor
    in_x: Tensor
    powers_y: Tensor
    powers_x: Tensor
    #: Those of up to twice the degree, and what the product of two of the others is made of, (.., .., 2 degree + 1).
    more_y: Tensor
    more_x: Tensor
    products_y: Tensor
    products_x: Tensor
    of_y: Tensor
    of_x: Tensor
    #: Standard deviation of each term, in `sigma`, (terms,).
    share: Tensor

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None, degree: int = 4
    ) -> None:
        super().__init__(shape, neutral, sigma=sigma)
        counted(degree=(degree, 20))
        orders = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i) if i + j > 0]
        for k, axis in enumerate("yx"):
            side = shape[k - 2]
            for name, table in zip(("in", "powers", "more", "products"), _tables(side, degree), strict=True):
                self.register_buffer(f"{name}_{axis}", table, persistent=False)
            self.register_buffer(
                f"of_{axis}", torch.tensor([each[k] for each in orders], dtype=torch.long), persistent=False
            )
        self.register_buffer("share", DECAY ** ((self.of_y + self.of_x - 1).double() / 2), persistent=False)
        self.white = nn.Parameter(torch.zeros(len(orders), dtype=torch.float64))

    @property
    def scales(self) -> Tensor:
        """Standard deviation of each term, (terms,)."""
        return self.sigma * self.share

    @property
    def values(self) -> Tensor:
        """The deviation from neutral, float64, (1, 1, h, w); without a strength, (1, 1, 1, 1)."""
        if not self.sigma > 0:
            return self.white.new_zeros(1, 1, 1, 1)
        return self.spread(self.scales * self.white)[None, None]

    def in_rows(self, terms: Tensor) -> Tensor:
        """In each row a combination (..., h, degree + 1) of the polynomials `in_x`; of coefficients (..., terms)."""
        table = terms.new_zeros(*terms.shape[:-1], len(self.in_y), len(self.in_x))
        table[..., self.of_y, self.of_x] = terms
        return self.in_y.T @ table

    def spread(self, terms: Tensor) -> Tensor:
        """The map (..., h, w) of coefficients (..., terms)."""
        return self.in_rows(terms) @ self.in_x

    def sampled(self, rows: slice, columns: slice) -> Tensor:
        """Each term at some pixels, (terms, rows * columns)."""
        y, x = self.in_y[self.of_y, rows], self.in_x[self.of_x, columns]
        return (y[:, :, None] * x[:, None]).flatten(1)

    def down(self, maps: Tensor) -> Tensor:
        """Sums of maps (..., h, w) down the columns, times each of the polynomials up to twice the degree."""
        return self.more_y @ maps

    def by_row(self, maps: Tensor) -> Tensor:
        """Sums of maps (..., h, w) with each term along each row, (..., terms, h)."""
        return (maps @ self.in_x.T).mT[..., self.of_x, :] * self.in_y[self.of_y]

    def by_column(self, down: Tensor) -> Tensor:
        """Sums of maps with each term down each column, (..., terms, w), from `down`."""
        return down[..., self.of_y, :] * self.in_x[self.of_x]

    def at(self, y: Tensor, x: Tensor) -> Tensor:
        """Each term at points in px from the centre, (..., terms)."""
        along = []
        for at, side, powers, order in (
            (y, self.in_y.shape[1], self.powers_y, self.of_y),
            (x, self.in_x.shape[1], self.powers_x, self.of_x),
        ):
            place = torch.linalg.vander(2 * at / (side - 1), N=len(powers))
            along.append(place @ powers[:, order])
        return along[0] * along[1]

    def sums(self, maps: Tensor) -> Tensor:
        """Sums of maps (..., h, w) with each term, (..., terms): the transpose of `spread`."""
        return self.sums_of(self.down(maps))

    def sums_of(self, down: Tensor) -> Tensor:
        """The same from `down`."""
        return (down[..., : len(self.in_y), :] @ self.in_x.T)[..., self.of_y, self.of_x]

    def nearest(self, maps: Tensor) -> Tensor:
        """The level and polynomial that are nearest to maps (..., h, w), as such maps."""
        area = maps.shape[-2] * maps.shape[-1]
        return maps.mean((-2, -1), keepdim=True) + self.spread(self.sums(maps) / area)

    def gram(self, down: Tensor) -> Tensor:
        """Sums of maps with each product of two terms, (..., terms, terms), from `down`."""
        sums = self.products_y @ (down @ self.more_x.T) @ self.products_x.T
        sums = sums.unflatten(-1, 2 * [len(self.in_x)]).unflatten(-3, 2 * [len(self.in_y)])
        return sums[..., self.of_y[:, None], self.of_y, self.of_x[:, None], self.of_x]

    def over_map(self, variance: Tensor) -> Tensor:
        """Variance of the map for that of the terms, couplings left out."""
        y, x = self.in_y[self.of_y].square(), self.in_x[self.of_x].square()
        return (variance * y.T @ x)[None, None]

    @torch.no_grad()
    def assign(self, values: Tensor) -> None:
        """Set the deviation from neutral to the polynomial nearest to `values`, a map."""
        whole = values.expand(self.shape)[0, 0]
        terms = self.sums(whole) / whole.numel()
        self.white.copy_(terms / self.scales if self.sigma > 0 else torch.zeros_like(terms))

    @classmethod
    def example(cls) -> Shading:
        """A map of 6 x 7 px."""
        return cls((1, 1, 6, 7), 1.0, sigma=0.1)


@functools.lru_cache(maxsize=16)  # a run builds its problem twice, for gain and offset
def _tables(side: int, degree: int) -> tuple[Tensor, ...]:
    """`in`, `powers`, `more` and `products` of an axis."""
    more = torch.from_numpy(_legendre(side, min(2 * degree, side - 1)))
    polynomials = more[: degree + 1]
    products = (polynomials[:, None] * polynomials) @ more.T / side
    powers = torch.linalg.vander(torch.linspace(-1, 1, side, dtype=torch.float64), N=degree + 1)
    solved = torch.linalg.lstsq(powers, polynomials.T, driver="gels").solution
    return polynomials, solved, more, products.flatten(0, 1)


def _legendre(side: int, degree: int) -> np.ndarray:
    """Polynomials of degree 0 to `degree` at the pixels, orthogonal, of mean square one: (degree + 1, side)."""
    powers = np.vander(np.linspace(-1, 1, side), degree + 1, increasing=True)
    basis, triangle = np.linalg.qr(powers)
    return np.sqrt(side) * np.ascontiguousarray((basis * np.sign(np.diag(triangle))).T)
