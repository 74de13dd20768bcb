"""Marginal likelihood of the variances of Gaussian unknowns (type-II maximum likelihood)."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

#: Regularisation of unknowns without a prior, relative to the mean of their diagonal: some are indistinguishable.
IMPROPER_RIDGE = 1e-9


class MarginalLikelihood:
    """Marginal likelihood for a negative log-likelihood `½ x' A x - b' x` whose first unknowns have a flat prior.

    Attributes:
        system: Schur complement of A after integration over the first unknowns.
        score: The corresponding part of b.
        constant: Nats of that integral.

    Args:
        normal: A, (K, K).
        rhs: b, (K,).
        n_improper: Number of unknowns with a flat prior.
    """

    def __init__(self, normal: Tensor, rhs: Tensor, n_improper: int) -> None:
        a, b = normal[:n_improper, :n_improper], normal[:n_improper, n_improper:]
        a = a + IMPROPER_RIDGE * a.diagonal().mean() * torch.eye(n_improper, dtype=a.dtype, device=a.device)
        self.back = torch.linalg.solve(a, torch.cat((b, rhs[:n_improper, None]), 1))
        self.system = normal[n_improper:, n_improper:] - b.T @ self.back[:, :-1]
        self.score = rhs[n_improper:] - b.T @ self.back[:, -1]
        self.constant = (torch.linalg.slogdet(a).logabsdet - rhs[:n_improper] @ self.back[:, -1]) / 2

    def nats(self, prior: Tensor) -> Tensor:
        """Negative log marginal likelihood, nats up to a constant, (M,), for prior variances (M, unknowns)."""
        prior = prior.to(self.system)
        one = torch.eye(prior.shape[1], dtype=prior.dtype, device=prior.device)
        triangle, _ = torch.linalg.cholesky_ex(
            one + prior[:, :, None].sqrt() * self.system * prior[:, None].sqrt()
        )
        whitened = torch.linalg.solve_triangular(
            triangle, (prior.sqrt() * self.score)[..., None], upper=False
        )
        return (triangle.diagonal(dim1=1, dim2=2).log().sum(1) - whitened.square().sum((1, 2)) / 2).cpu()

    def posterior(self, prior: Tensor) -> tuple[Tensor, Tensor]:
        """Posterior means of the first unknowns and of the others, for prior variances (unknowns,) of the latter."""
        prior = prior.to(self.system)
        system = torch.eye(len(prior), dtype=prior.dtype, device=prior.device) + prior[:, None] * self.system
        mean = torch.linalg.solve(system, prior * self.score)
        return self.back[:, -1] - self.back[:, :-1] @ mean, mean


def normal_matrix(columns: Iterable[Tensor], precision: Tensor, own: Tensor) -> Tensor:
    """Products `C' W C` of the columns of frames, (U, U), with what each pixel has of its own integrated out.

    Args:
        columns: for each of N frames, (U, K).
        precision: of the samples, W, (N, K).
        own: what two unknowns of each pixel, of variance one, make of its samples, (N, 2, K).
    """
    information = torch.eye(2, dtype=own.dtype, device=own.device)[..., None]
    whole = shared = own.new_zeros(())
    for each, weight, pixel in zip(columns, precision, own, strict=True):
        weighted = each * weight
        whole = whole + weighted @ each.T
        shared = torch.addcmul(shared, weighted[:, None], pixel)
        information = information + weight * pixel[:, None] * pixel
    (a, b), (_, d) = information
    root, of_both = a.sqrt(), b / a
    first = shared[:, 0] / root
    second = (shared[:, 1] - of_both * shared[:, 0]) / (d - of_both * b).sqrt()
    whitened = torch.cat((first, second), 1)  # by Cholesky's factors
    return whole - whitened @ whitened.T
