"""Shading: the low-order part of gain and offset, from optics and housing."""

from __future__ import annotations

import functools

import numpy as np
import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.fields.sensor_maps import GaussianMap
from deepir.registry import register

VARIANCE_DECAY = 0.1  # variance of a term relative to one of the next lower degree


@register("field", "shading")
class Shading(GaussianMap):
    """Polynomial over the frame without a constant, in products of discrete Legendre polynomials.

    Each degree has a tenth of the variance of the one below: optics and housing cause mostly slopes and bowls.

    Args:
        shape: (1, 1, h, w).
        neutral: Value that leaves the data unchanged.
        sigma: Prior standard deviation of each linear term, root mean square over the frame; estimated if None.
        degree: Largest total degree.
    """

    #: The polynomials along each axis, (degree + 1, side), what powers they are made of, and which of them each term
    #: has, (terms,).
    basis_y: Tensor
    basis_x: Tensor
    powers_y: Tensor
    powers_x: Tensor
    #: Those of up to twice the degree, and what the product of two of the others is made of, (.., .., 2 degree + 1).
    extended_y: Tensor
    extended_x: Tensor
    products_y: Tensor
    products_x: Tensor
    order_y: Tensor
    order_x: Tensor
    #: Standard deviation of each term, in `sigma`, (terms,).
    relative_sigma: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None, degree: int = 4) -> None:
        super().__init__(shape, neutral, sigma=sigma)
        check_counts(degree=(degree, 20))
        orders = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i) if i + j > 0]
        for k, axis in enumerate("yx"):
            side = shape[k - 2]
            for name, table in zip(("basis", "powers", "extended", "products"), _tables(side, degree), strict=True):
                self.register_buffer(f"{name}_{axis}", table, persistent=False)
            self.register_buffer(
                f"order_{axis}", torch.tensor([each[k] for each in orders], dtype=torch.long), persistent=False
            )
        self.register_buffer(
            "relative_sigma", VARIANCE_DECAY ** ((self.order_y + self.order_x - 1).double() / 2), persistent=False
        )
        self.whitened = nn.Parameter(torch.zeros(len(orders), dtype=torch.float64))

    @property
    def prior_sigma(self) -> Tensor:
        """Prior standard deviation of each term, (terms,)."""
        return self.sigma * self.relative_sigma

    @property
    def values(self) -> Tensor:
        """The deviation from neutral, float64, (1, 1, h, w); without a strength, (1, 1, 1, 1)."""
        if not self.sigma > 0:
            return self.whitened.new_zeros(1, 1, 1, 1)
        return self.synthesise(self.prior_sigma * self.whitened)[None, None]

    def row_coefficients(self, terms: Tensor) -> Tensor:
        """Coefficients of `basis_x` in each row, (..., h, degree + 1), from those of the terms, (..., terms)."""
        table = terms.new_zeros(*terms.shape[:-1], len(self.basis_y), len(self.basis_x))
        table[..., self.order_y, self.order_x] = terms
        return self.basis_y.T @ table

    def synthesise(self, terms: Tensor) -> Tensor:
        """The map (..., h, w) of coefficients (..., terms)."""
        return self.row_coefficients(terms) @ self.basis_x

    def sample_basis(self, rows: slice, columns: slice) -> Tensor:
        """Each term at some pixels, (terms, rows * columns)."""
        y, x = self.basis_y[self.order_y, rows], self.basis_x[self.order_x, columns]
        return (y[:, :, None] * x[:, None]).flatten(1)

    def column_moments(self, maps: Tensor) -> Tensor:
        """Inner products of the columns of maps (..., h, w) with the extended polynomials, (..., 2 degree + 1, w)."""
        return self.extended_y @ maps

    def row_sums(self, maps: Tensor) -> Tensor:
        """Inner products of each row of maps (..., h, w) with each term, (..., terms, h)."""
        return (maps @ self.basis_x.T).mT[..., self.order_x, :] * self.basis_y[self.order_y]

    def column_sums(self, down: Tensor) -> Tensor:
        """Inner products of each column with each term, (..., terms, w), from `column_moments`."""
        return down[..., self.order_y, :] * self.basis_x[self.order_x]

    def evaluate(self, y: Tensor, x: Tensor) -> Tensor:
        """Each term at points in px from the centre, (..., terms)."""
        along = []
        for at, side, powers, order in (
            (y, self.basis_y.shape[1], self.powers_y, self.order_y),
            (x, self.basis_x.shape[1], self.powers_x, self.order_x),
        ):
            place = torch.linalg.vander(2 * at / (side - 1), N=len(powers))
            along.append(place @ powers[:, order])
        return along[0] * along[1]

    def analyse(self, maps: Tensor) -> Tensor:
        """Inner products of maps (..., h, w) with each term, (..., terms): the transpose of `synthesise`."""
        return self.analyse_moments(self.column_moments(maps))

    def analyse_moments(self, down: Tensor) -> Tensor:
        """As `analyse`, from `column_moments`."""
        return (down[..., : len(self.basis_y), :] @ self.basis_x.T)[..., self.order_y, self.order_x]

    def project(self, maps: Tensor) -> Tensor:
        """Least-squares projection of maps (..., h, w) onto level and polynomials, as maps."""
        area = maps.shape[-2] * maps.shape[-1]
        return maps.mean((-2, -1), keepdim=True) + self.synthesise(self.analyse(maps) / area)

    def gram(self, down: Tensor) -> Tensor:
        """Inner products of maps with products of two terms, (..., terms, terms), from `column_moments`."""
        sums = self.products_y @ (down @ self.extended_x.T) @ self.products_x.T
        sums = sums.unflatten(-1, 2 * [len(self.basis_x)]).unflatten(-3, 2 * [len(self.basis_y)])
        return sums[..., self.order_y[:, None], self.order_y, self.order_x[:, None], self.order_x]

    def map_variance(self, variance: Tensor) -> Tensor:
        """Variance of the map, (1, 1, h, w), from variances of the terms; covariances are neglected."""
        y, x = self.basis_y[self.order_y].square(), self.basis_x[self.order_x].square()
        return (variance * y.T @ x)[None, None]

    @torch.no_grad()
    def assign(self, values: Tensor) -> None:
        """Set the deviation from neutral to the projection of a map `values`."""
        whole = values.expand(self.shape)[0, 0]
        terms = self.analyse(whole) / whole.numel()
        self.whitened.copy_(terms / self.prior_sigma if self.sigma > 0 else torch.zeros_like(terms))


@functools.lru_cache(maxsize=16)  # a run builds its problem twice, for gain and offset
def _tables(side: int, degree: int) -> tuple[Tensor, ...]:
    """`basis`, `powers`, `extended` and `products` of an axis."""
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
