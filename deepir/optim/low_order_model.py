"""Low-order model of a burst: polynomials of scene and pattern, and the levels of the frames.

A camera that moves by d over a slope of the sensor sees its level change in proportion to d, as in a drift; over a
quadratic offset it sees slopes that vary between frames. The marginal likelihood of the low-order parts of the frames
separates these causes; a solve is preconditioned by their Hessian.

The low-order part of frame j is `c_j = T_j θ + φ + l_j`: coefficients θ of polynomials of the scene, transported by the
motion, φ of the pattern, the same in all frames, and the level l_j in the constant term. Its negative log-likelihood is
`½ c' M_j c - q_j' c`, nats.
"""

from __future__ import annotations

import copy
import functools
import math
from collections.abc import Collection, Sequence
from typing import Any

import torch
from torch import Tensor

from deepir.arrays.statistics import MAX_SAMPLES_PER_FRAME, median_sigma, subsample
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import Drift, level_basis
from deepir.fields.shading import Shading
from deepir.operators import Lag
from deepir.problem import Problem

N_SAMPLING_POINTS = 40  # points along each axis at which the polynomials are sampled
#: Regularisation of the information of frames, relative to the mean of its diagonal: some frames have none.
INFORMATION_RIDGE = 1e-12
MIN_CURVATURE_RATIO = 1e-8  # smallest curvature, relative to the mean
#: Largest prior standard deviation of the gain of lines that is treated as an additive pattern.
MAX_ADDITIVE_LINE_GAIN = 0.15
SHADING_KEY = (-1, 1)  # key of the variance of the shading; no axes

Variances = dict[tuple[int, ...], float]  # variances of the pattern, by the axes along which it is constant


class LowOrderModel:
    """The low-order parts of a burst, whose scene is seen through a warp.

    `scene`: a shading whose polynomials are over the canvas, `frame`: over a frame; `transport` (N, terms + 1, terms):
    T_j; `information` (N, terms + 1, terms + 1): M_j.
    """

    def __init__(self, problem: Problem, canvas: tuple[int, ...]) -> None:
        warp: Any = problem.operator.named()[0][1]
        device = problem.data.device
        height, width = problem.data.shape[-2:]  # what the warp shows may be larger, by a blur's reach
        self.problem = problem
        self.scene, self.frame = (polynomials(*size, device) for size in (canvas[-2:], (height, width)))
        step_y, step_x = max(height // N_SAMPLING_POINTS, 1), max(width // N_SAMPLING_POINTS, 1)
        motion = problem.fields[problem.motion_unknown()]().double()
        y0, x0 = ((of - side) // 2 for of, side in zip(warp.size, (height, width), strict=True))
        some = slice(y0, y0 + height, step_y), slice(x0, x0 + width, step_x)
        points = warp.sampling_points(warp.instants.interpolate(motion), *some).flatten(1, 2)
        terms = self.frame.sample_basis(slice(None, None, step_y), slice(None, None, step_x)).T
        terms = torch.cat((torch.ones_like(terms[:, :1]), terms), 1)
        self.stride, self.terms = (step_y, step_x), terms
        seen = apply_lag(problem, self.scene.evaluate(points[..., 1], points[..., 0]))
        self.transport = torch.linalg.solve(terms.T @ terms, terms.T @ seen)  # next to orthogonal
        few = slice(None), 0, slice(None, None, step_y), slice(None, None, step_x)
        weights = problem.precision[few].masked_fill(problem.held_out[few], 0).double().flatten(1)
        area = height * width / weights.shape[1]
        self.information = area * terms.T @ (weights[..., None] * terms)
        self.shrinkage = torch.eye(terms.shape[1], dtype=terms.dtype, device=device).expand_as(self.information)

    def with_frame_variance(self, variance: Tensor) -> LowOrderModel:
        """Copy with an added independent variance of the low-order coefficients of each frame, (terms + 1,)."""
        found = copy.copy(self)
        found.shrinkage = torch.linalg.inv(self.shrinkage + self.information * variance)
        found.information = found.shrinkage @ self.information
        return found

    def normal_matrix(self, *more: Tensor) -> Tensor:
        """Normal matrix of (θ, level of the pattern, φ, `more`), with columns such as those of the frame levels."""
        maps = self._design(more)
        return (maps.mT @ self.information @ maps).sum(0)

    def frame_scores(self, residual: Tensor) -> Tensor:
        """q_j, (N, terms + 1), from residuals of the frames (N, h, w)."""
        weighted = (self.problem.fitted()[:, 0] * residual).double()
        return torch.cat((weighted.sum((1, 2))[:, None], self.frame.analyse(weighted)), 1)

    def right_hand_side(self, seen: Tensor, *more: Tensor) -> Tensor:
        """Right-hand side of the normal equations from all q_j."""
        return (self._design(more).mT @ self.shrinkage @ seen[..., None]).sum(0)[:, 0]

    def null_nats(self, seen: Tensor) -> Tensor:
        """Negative log-likelihood of the frame scores without low-order parts, nats up to a constant."""
        scores = (self.shrinkage @ seen[..., None])[..., 0]
        system = self.information.clone()
        system.diagonal(dim1=1, dim2=2).add_(INFORMATION_RIDGE * self.information.diagonal(dim1=1, dim2=2).mean())
        values = torch.linalg.solve(system, scores)
        return ((values * scores).sum() - torch.linalg.slogdet(self.shrinkage).logabsdet.sum()) / 2

    def level_columns(self) -> Tensor:
        """Columns of the unknowns of a drift, (N, terms + 1, N)."""
        count, size, _ = self.transport.shape
        made = level_basis(count, self.transport.device)
        return torch.cat((made[:, None], made.new_zeros(count, size - 1, count)), 1)

    def basis_columns(self, field: BasisExpansion) -> tuple[Tensor, Tensor]:
        """Low-order projection of the K terms of a map, (terms + 1, K), and the rest, (K, points y, points x)."""
        maps = field.sample_basis(*self.stride).double()
        low_order = torch.linalg.lstsq(self.terms, maps.flatten(1).T, driver="gels").solution
        return low_order, maps - (self.terms @ low_order).T.reshape(maps.shape)

    def _design(self, more: Sequence[Tensor]) -> Tensor:
        """Design matrix of each frame, (N, terms + 1, unknowns)."""
        count, size, _ = self.transport.shape
        one = torch.eye(size, dtype=self.transport.dtype, device=self.transport.device)
        return torch.cat([each.expand(count, size, -1) for each in (self.transport, one, *more)], 2)


@functools.lru_cache(maxsize=8)  # a solve asks for the same ones each time that its strengths are estimated
def polynomials(height: int, width: int, device: torch.device) -> Shading:
    """Polynomials over a map of this size."""
    return Shading((1, 1, height, width)).to(device)


def apply_lag(problem: Problem, seen: Tensor) -> Tensor:
    """Apply the lag operator along time to (instants, ...), (N, ...); identity without one."""
    for name, stage in problem.operator.named():
        if isinstance(stage, Lag):
            slots = {
                slot: problem.field_of(f"{name}.{slot}")().mean().to(seen).expand(1, 1, 1, 1)
                for slot in ("tau", "moving")
            }
            shown = stage(seen.flatten(1)[:, None, None], **slots)
            return shown.view(-1, *seen.shape[1:])
    return seen


def pattern_variances(problem: Problem, eliminated: Collection[str], max_line_gain: float = math.inf) -> Variances:
    """Variance of the free pattern, squared data units, by the axes along which it is constant.

    Line gains with a standard deviation above `max_line_gain` are left out.
    """
    data, precision = subsample(problem.data, problem.precision, max_samples=MAX_SAMPLES_PER_FRAME // len(problem.data))
    counts = precision > 0
    level = float(((data.square() * counts).sum() / counts.sum()).sqrt())
    found = {PIXEL: 0.0, COLUMN: 0.0, ROW: 0.0, SHADING_KEY: 0.0}
    for kind, unit in (("gain", level), ("offset", 1.0)):
        name = problem.slots.get(f"{problem.operator.named()[-1][0]}.{kind}", "")
        for part in problem.fields[name].parts() if name in eliminated else ():
            if kind == "gain" and part.constant_axes in (COLUMN, ROW) and part.sigma > max_line_gain:
                continue
            found[SHADING_KEY if isinstance(part, Shading) else part.constant_axes] += (float(part.sigma) * unit) ** 2
    return found


def additive_variances(problem: Problem, eliminated: Collection[str]) -> Variances:
    """Variances of the pattern, without line gains above `MAX_ADDITIVE_LINE_GAIN`."""
    return pattern_variances(problem, eliminated, MAX_ADDITIVE_LINE_GAIN)


def expected_variances(variance: Variances, frame: Shading) -> Tensor:
    """Prior variance of each polynomial of a frame in a pattern of these variances, without shading."""
    height, width = frame.shape[-2:]
    each = torch.full((len(frame.whitened),), variance[PIXEL] / (height * width), dtype=torch.float64)
    each = each.to(frame.order_y.device)
    return each + (frame.order_y == 0) * variance[COLUMN] / width + (frame.order_x == 0) * variance[ROW] / height


def low_order_inverse_hessian(
    problem: Problem, low_order: LowOrderModel, others: Sequence[Drift | BasisExpansion], eliminated: Collection[str]
) -> Tensor:
    """Inverse Hessian of the scene's polynomials and of free frame levels and stray flux.

    The polynomials of the pattern are eliminated with their prior variances: where the motion does not separate slopes
    of scene and pattern, only these determine them.
    """
    scene: Any = problem.fields["scene"]
    terms = len(low_order.scene.whitened)
    found = additive_variances(problem, eliminated)
    maps = [
        low_order.level_columns() if isinstance(each, Drift) else low_order.basis_columns(each)[0] for each in others
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
        expected_variances(found, low_order.frame) + found[SHADING_KEY] * low_order.frame.relative_sigma.square()
    )
    whole.diagonal()[terms + 1 : 2 * terms + 1] += 1 / prior_variance.clamp(min=1e-30)  # the pattern's level is free
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
    of_value, of_gradient = penalty_curvature(problem, problem.fields["scene"]())
    basis = low_order.scene  # of products of functions of y and of x, whose sums are products, too
    (y, down), (x, right) = (
        [each @ each.T for each in (along[of], along[of].diff(dim=-1))]
        for along, of in ((basis.basis_y, basis.order_y), (basis.basis_x, basis.order_x))
    )
    return of_value * y * x + of_gradient * (y * right + down * x)


def penalty_curvature(problem: Problem, scene: Tensor) -> tuple[float, float]:
    """Mean curvature of the scene's penalties in its values, and in its squared gradient."""
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    curvatures = [penalty.mean_curvature(scene) for penalty in penalties]
    of_value, of_gradient = (sum(each) for each in zip((0.0, 0.0), *curvatures, strict=True))
    return of_value, of_gradient
