"""How likely variances of Gaussian unknowns are, when others may be anything."""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

RIDGE = 1e-9  # of those without a prior, as a share of the mean: some look the same


class MarginalLikelihood:
    """Of data that say `½ x' A x - b' x` nats of unknowns, of which the first `free` have no prior.

    `system` and `score`: what is left of A and b for the others, once the first are integrated out, which makes
    `constant` nats.
    """

    def __init__(self, normal: Tensor, rhs: Tensor, free: int) -> None:
        a, b = normal[:free, :free], normal[:free, free:]
        a = a + RIDGE * a.diagonal().mean() * torch.eye(free, dtype=a.dtype, device=a.device)
        self.back = torch.linalg.solve(a, torch.cat((b, rhs[:free, None]), 1))
        self.system = normal[free:, free:] - b.T @ self.back[:, :-1]
        self.score = rhs[free:] - b.T @ self.back[:, -1]
        self.constant = (torch.linalg.slogdet(a).logabsdet - rhs[:free] @ self.back[:, -1]) / 2

    def nats(self, prior: Tensor) -> Tensor:
        """Minus the evidence's logarithm, up to a constant, (K,), for variances (K, unknowns) of the others."""
        one = torch.eye(prior.shape[1], dtype=prior.dtype, device=prior.device)
        triangle, _ = torch.linalg.cholesky_ex(
            one + prior[:, :, None].sqrt() * self.system * prior[:, None].sqrt()
        )
        white = torch.linalg.solve_triangular(triangle, (prior.sqrt() * self.score)[..., None], upper=False)
        return (triangle.diagonal(dim1=1, dim2=2).log().sum(1) - white.square().sum((1, 2)) / 2).cpu()

    def posterior(self, prior: Tensor) -> tuple[Tensor, Tensor]:
        """Means of the first unknowns, and of the others, for their variances (unknowns,)."""
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
    told = torch.eye(2, dtype=own.dtype, device=own.device)[..., None]
    whole = shared = own.new_zeros(())
    for each, weight, pixel in zip(columns, precision, own, strict=True):
        weighted = each * weight
        whole = whole + weighted @ each.T
        shared = torch.addcmul(shared, weighted[:, None], pixel)
        told = told + weight * pixel[:, None] * pixel
    (a, b), (_, d) = told
    root, of_both = a.sqrt(), b / a
    first = shared[:, 0] / root
    second = (shared[:, 1] - of_both * shared[:, 0]) / (d - of_both * b).sqrt()
    white = torch.cat((first, second), 1)  # by Cholesky's factors
    return whole - white @ white.T
