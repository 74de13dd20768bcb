"""Dense Hessian of the objective in the low-order scene, frame levels and stray flux."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.arrays.statistics import median_sigma
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import Drift
from deepir.optim.fourier_hessian import MIN_CURVATURE_RATIO, additive_variances
from deepir.optim.low_order_model import SHADING_KEY, LowOrderModel, Variances, expected_variances
from deepir.problem import Problem


def low_order_inverse_hessian(
    problem: Problem,
    low_order: LowOrderModel,
    others: Sequence[Drift | BasisExpansion],
    eliminated: Collection[str],
) -> Tensor:
    """Inverse Hessian of the scene's polynomials and of free frame levels and stray flux.

    The polynomials of the pattern are eliminated with their prior variances: where the motion does not separate slopes
    of scene and pattern, only these determine them.
    """
    scene: Any = problem.fields["scene"]
    terms = len(low_order.scene.whitened)
    found = additive_variances(problem, eliminated)
    maps = [
        low_order.level_columns() if isinstance(each, Drift) else low_order.basis_columns(each)[0]
        for each in others
    ]
    whole = low_order.normal_matrix(*maps)
    unit = whole.new_full((len(whole),), float(scene.scale))
    at = 2 * terms + 1
    for each, made in zip(others, maps, strict=True):
        mine = slice(at, at := at + made.shape[-1])
        unit[mine] = float(each.preconditioning_scale)
        if isinstance(each, BasisExpansion):
            whole[mine, mine] += _stray_flux_curvature(problem, low_order, each, found)
        else:  # a steady change is steps, too
            whole[mine, mine].diagonal().add_(1 / each.sigma.double().square())
    prior_variance = (
        expected_variances(found, low_order.frame)
        + found[SHADING_KEY] * low_order.frame.relative_sigma.square()
    )
    whole.diagonal()[terms + 1 : 2 * terms + 1] += 1 / prior_variance.clamp(
        min=1e-30
    )  # the pattern's level is free
    whole[:terms, :terms] += _penalty_curvature(problem, low_order)
    pattern = torch.arange(len(whole), device=whole.device)
    pattern = (pattern >= terms) & (pattern <= 2 * terms)
    own, shared = whole[pattern][:, pattern], whole[pattern][:, ~pattern]
    system = whole[~pattern][:, ~pattern] - shared.T @ torch.linalg.solve(own, shared)
    unit = unit[~pattern]
    system = unit[:, None] * system * unit
    system.diagonal().add_(MIN_CURVATURE_RATIO * system.diagonal().mean())
    # As it lies in a checkpoint: the order of the sums of its products follows from it.
    return torch.linalg.inv(system).contiguous()


def _stray_flux_curvature(
    problem: Problem, low_order: LowOrderModel, field: BasisExpansion, variance: Variances
) -> Tensor:
    """Hessian of stray flux in its prior and in its high-order part, behind a free pattern."""
    _, rest = low_order.basis_columns(field)
    height, width = problem.data.shape[-2:]
    unsure = median_sigma(problem.precision) ** 2 / len(problem.data) + variance[PIXEL]
    columns, rows = rest.mean(1, keepdim=True).expand_as(rest), rest.mean(2, keepdim=True).expand_as(rest)
    curvature = torch.eye(len(rest), dtype=rest.dtype, device=rest.device) / field.sigma.double().square()
    for part, more in (
        (rest - columns - rows, 0.0),
        (columns, height * variance[COLUMN]),
        (rows, width * variance[ROW]),
    ):
        flat = part.flatten(1)
        curvature += height * width / (unsure + more) * flat @ flat.T / flat.shape[1]
    return curvature


def _penalty_curvature(problem: Problem, low_order: LowOrderModel) -> Tensor:
    """Hessian of the scene's penalties in its polynomials."""
    value = problem.fields["scene"]()
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    curvatures = [penalty.mean_curvature(value) for penalty in penalties]
    of_value, of_gradient = (sum(each) for each in zip((0.0, 0.0), *curvatures, strict=True))
    basis = low_order.scene  # of products of functions of y and of x, whose sums are products, too
    (y, down), (x, right) = (
        [each @ each.T for each in (along[of], along[of].diff(dim=-1))]
        for along, of in ((basis.basis_y, basis.order_y), (basis.basis_x, basis.order_x))
    )
    return of_value * y * x + of_gradient * (y * right + down * x)
