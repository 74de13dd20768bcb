"""Shading: the smooth part of gain and offset, from the optics and the housing."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from deepir.priors.field import Shape
from deepir.priors.parts import Part
from deepir.registry import register


@register("field", "shading")
class Shading(Part):
    """A polynomial over the frame, without a constant; `sigma` is that of each of its terms, root mean square.

    The terms are products of Legendre polynomials in y and x, orthogonal over the pixels, of a total degree up to
    `degree`.
    """

    #: The polynomials along each axis, (degree + 1, side), and which of them each term has, (terms,).
    in_y: Tensor
    in_x: Tensor
    of_y: Tensor
    of_x: Tensor

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None, degree: int = 4
    ) -> None:
        super().__init__(shape, neutral, sigma=sigma)
        orders = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i) if i + j > 0]
        for k, axis in enumerate("yx"):
            polynomials = torch.from_numpy(_legendre(shape[k - 2], degree))
            self.register_buffer(f"in_{axis}", polynomials, persistent=False)
            self.register_buffer(
                f"of_{axis}", torch.tensor([each[k] for each in orders], dtype=torch.long), persistent=False
            )
        self.white = nn.Parameter(torch.zeros(len(orders), dtype=torch.float64))

    @property
    def values(self) -> Tensor:
        """The deviation from neutral, float64, (1, 1, h, w)."""
        return self.spread(self.sigma * self.white)[None, None]

    def factors(self) -> tuple[Tensor, Tensor]:
        """How each term depends on y, (terms, h), and on x, (terms, w)."""
        return self.in_y[self.of_y], self.in_x[self.of_x]

    def spread(self, terms: Tensor) -> Tensor:
        """The map (..., h, w) of coefficients (..., terms)."""
        y, x = self.factors()
        return (terms[..., None, :] * y.T) @ x

    def sums(self, maps: Tensor) -> Tensor:
        """Its transpose: maps (..., h, w) summed with each term, (..., terms)."""
        y, x = self.factors()
        return (maps @ x.T * y.T).sum(-2)

    def gram(self, weights: Tensor) -> Tensor:
        """Sums of each product of two terms, times `weights` (h, w): (terms, terms)."""
        # From those of the few products of two polynomials along an axis.
        y, x = ((each[:, None] * each).flatten(0, 1) for each in (self.in_y, self.in_x))
        sums = (y @ weights @ x.T).reshape(2 * [len(self.in_y)] + 2 * [len(self.in_x)])
        return sums[self.of_y[:, None], self.of_y, self.of_x[:, None], self.of_x]

    @torch.no_grad()
    def assign(self, values: Tensor) -> None:
        """Set the deviation from neutral to the polynomial nearest to `values`, a map."""
        terms = self.sums(values.expand(self.shape)[0, 0]) / values.expand(self.shape)[0, 0].numel()
        self.white.copy_(terms / self.sigma if self.sigma > 0 else torch.zeros_like(terms))

    @classmethod
    def example(cls) -> Shading:
        """A map of 6 x 7 px."""
        return cls((1, 1, 6, 7), 1.0, sigma=0.1)


def _legendre(side: int, degree: int) -> np.ndarray:
    """Polynomials of degree 0 to `degree` at the pixels, orthogonal, of mean square one: (degree + 1, side)."""
    powers = np.vander(np.linspace(-1, 1, side), degree + 1, increasing=True)
    basis, triangle = np.linalg.qr(powers)
    return np.sqrt(side) * np.ascontiguousarray((basis * np.sign(np.diag(triangle))).T)
