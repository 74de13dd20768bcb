"""Marginal likelihood of low-order gain, offset and frame levels, jointly with the scene.

Frame k is `(1 + γ) z_k + φ + l_k` with low-order gain γ and offset φ, plus the pattern of pixels. A scene estimated
without γ has absorbed part of it: it may be wrong by low-order factors ψ and sums θ, which the motion transports,
`z_k T_k ψ + T_k θ`, and the motion may be slightly wrong. With these free and the pixel pattern integrated out, the
marginal likelihood of φ, l and γ is that of a Gaussian with some forty unknowns. Texture that fades towards the corners
identifies γ. Frames may have gains of their own, about the middle of the data.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.estimation.low_order_evidence import (
    MIN_LOG_BAYES_FACTOR_DRIFT,
    MarginalLikelihood,
    frame_level_offsets,
    normal_matrix,
)
from deepir.estimation.residuals import has_line_noise, subtract_line_means
from deepir.fields.base import Field
from deepir.fields.shading import Shading
from deepir.optim.low_order_model import LowOrderModel, Variances, expected_variances
from deepir.problem import Problem

#: Pixels of a frame that are used, at most.
MAX_PIXELS = 16_000
#: Residual at which samples are clipped, in median absolute deviations.
RESIDUAL_CLIP_MADS = 7.5
#: Pixels of a block whose columns fit into the cache.
PIXELS_IN_CACHE = 1000
#: Degree up to which the low-order parts of a frame may be wrong.
MAX_ERROR_DEGREE = 2
#: Standard deviations on each axis of the coarse search.
N_COARSE_SIGMAS = 9
#: Standard deviations on each axis of the fine search, an octave to either side.
N_FINE_SIGMAS = 7


class GainOffsetEvidence:
    """Marginal likelihood of standard deviations (offset's shading, drift, gain's shading).

    Args:
        problem: Its current values give the residuals.
        frame_gains: Whether frames have free gains.
        doubt: Variances of further errors of the low-order parts of a frame, (terms + 1,); degrees up to
            `MAX_ERROR_DEGREE` count.
    """

    def __init__(self, problem: Problem, *, frame_gains: bool = False, doubt: Tensor | None = None) -> None:
        values = dict(problem.values())
        flux = problem.flux(values)
        problem.eliminate(values, problem.closed_form(), flux=flux)
        self.low_order = LowOrderModel(problem, tuple(values["scene"].shape))
        frame = self.low_order.frame
        self.low = (frame.order_y + frame.order_x <= MAX_ERROR_DEGREE) & (doubt is not None)
        self.doubt = frame.relative_sigma[self.low] if doubt is None else doubt[1:][self.low]  # none, or some
        step = math.ceil((flux[0].numel() / MAX_PIXELS) ** 0.5)
        some = slice(1, -1, step), slice(1, -1, step)
        seen = flux, problem.data - frame_level_offsets(problem), problem.fitted()
        self.shape = flux[0, 0, *some].shape
        z, data, precision = (each[:, 0, *some].flatten(1) for each in seen)
        self.level = float(z.double().square().mean().sqrt())
        self.spread = float(masked_values(data, precision > 0).std())
        of_gain, of_offset = (_variances(field) for field in gain_and_offset(problem))
        gain, offset = (
            _high_order_lines(field, frame)[some].to(flux).flatten() for field in gain_and_offset(problem)
        )
        residual = data - (1 + gain) * z - offset
        pixels = self.level**2 * of_gain.pop(PIXEL), of_offset.pop(PIXEL)
        self.expected = [
            expected_variances({PIXEL: 0.0} | lines, frame) * unit
            for lines, unit in ((of_offset, 1.0), (of_gain, self.level**2))
        ]
        left = masked_values(residual, precision > 0)
        middle = median(left)
        limit = RESIDUAL_CLIP_MADS * median((left - middle).abs())
        residual = middle + (residual - middle).clamp(-limit, limit)
        z = z.double() / self.level
        own = torch.stack((pixels[0] ** 0.5 * z, pixels[1] ** 0.5 * torch.ones_like(z)), 1)
        terms = frame.sample_basis(*some)
        moves = _motion_derivatives(flux[:, 0], step).double()
        moves /= moves.square().mean((0, 2), keepdim=True).sqrt().clamp(min=1e-30)
        shown = (data - problem.middle()).double() / self.spread if frame_gains else z[:0]
        maps = terms, z, moves, shown, residual.double(), precision.double(), own
        normal = z.new_zeros(())
        jump = has_line_noise(problem)
        count = self.shape.numel() if jump else PIXELS_IN_CACHE  # few are in the cache
        for *block, block_precision, pixel_columns in zip(
            *(each.split(count, -1) for each in maps), strict=True
        ):
            normal = normal + normal_matrix(self._columns(*block, jump=jump), block_precision, pixel_columns)
        self.count = len(flux)
        free = 2 * (len(frame.whitened) + 1) + (3 + frame_gains) * (self.count - 1)
        self.evidence = MarginalLikelihood(normal[:-1, :-1], normal[:-1, -1], free)

    def _columns(
        self, terms: Tensor, z: Tensor, moves: Tensor, shown: Tensor, residual: Tensor, *, jump: bool
    ) -> Iterator[Tensor]:
        """Yield the design matrix of each frame, (unknowns + 1, pixels), with the residual as last row.

        Order of the unknowns: θ, level of the pattern, ψ, its level, motions, frame gains; these have a flat prior.
        Then φ, frame levels, γ, errors of the low-order parts.
        """
        one = torch.ones_like(terms[:1])
        levels = self.low_order.level_columns()[:, 0]
        for k, zk in enumerate(z):
            carried = self.low_order.transport[k].T @ torch.cat((one, terms))
            moved = moves.new_zeros(len(z), *moves.shape[1:])
            moved[k] = moves[k]
            scene = carried, one, carried * zk, zk[None], moved[1:].flatten(0, 1)
            own = [levels[k, 1:, None] * each for each in shown[k : k + 1]]
            wrong = terms.new_zeros(len(z), len(self.doubt), terms.shape[1])
            wrong[k] = terms[self.low]
            pattern = terms, levels[k][:, None] * one, terms * zk, wrong.flatten(0, 1)
            columns = torch.cat((*scene, *own, *pattern, residual[k][None]))
            if jump:  # all of the frame is there
                columns = subtract_line_means(
                    self.low_order.problem, columns.unflatten(1, self.shape)
                ).flatten(1)
            yield columns

    def best(self, *, shaded: bool, drift: bool) -> tuple[float, list[float]]:
        """Standard deviations of maximum marginal likelihood.

        Args:
            shaded: Whether shading of the gain is a candidate.
            drift: Whether drift is a candidate, at the cost of `MIN_LOG_BAYES_FACTOR_DRIFT` nats.

        Returns:
            Negative log marginal likelihood, nats; standard deviations of the offset's shading, drift, gain's shading.
        """
        grid = self.spread * torch.logspace(-3.5, 0.5, N_COARSE_SIGMAS, dtype=torch.float64)
        zero = grid.new_zeros(1)
        near = 2 ** torch.linspace(-1, 1, N_FINE_SIGMAS, dtype=torch.float64)
        found = []
        for drifts in (False, True)[: 1 + drift]:
            gains = torch.logspace(-3, -0.5, N_COARSE_SIGMAS, dtype=torch.float64) if shaded else zero
            coarse = torch.cartesian_prod(grid, grid if drifts else zero, gains)
            start = coarse[self.nats(coarse).argmin()]
            finer = start * torch.cartesian_prod(near, *(near if s > 0 else near[:1] for s in start[1:]))
            nats = self.nats(finer)
            found.append(
                (float(nats.min()) + MIN_LOG_BAYES_FACTOR_DRIFT * drifts, finer[nats.argmin()].tolist())
            )
        return min(found)

    def frame_gains(self) -> Tensor:
        """Most likely frame gains (N,), mean one, with drifting levels and no gain shading."""
        _, strengths = self.best(shaded=False, drift=True)
        free, _ = self.evidence.posterior(self._prior(torch.tensor([strengths], dtype=torch.float64))[0])
        found = self.low_order.level_columns()[:, 0, 1:] @ free[1 - self.count :]
        return 1 + found / self.spread

    def nats(self, strengths: Tensor) -> Tensor:
        """Negative log marginal likelihood, nats up to a constant, (K,), of standard deviations (K, 3)."""
        return self.evidence.nats(self._prior(strengths))

    def _prior(self, strengths: Tensor) -> Tensor:
        """Variances of φ, levels and γ, (K, unknowns)."""
        offset, drift, gain = strengths.square().T[..., None]
        shape = self.low_order.frame.relative_sigma.square().cpu()
        of_offset, of_gain = (each.cpu() for each in self.expected)
        smooth = of_offset + offset * shape, of_gain + self.level**2 * gain * shape
        wrong = self.doubt.cpu().repeat(self.count).expand(len(drift), -1)
        return torch.cat((smooth[0], drift.expand(-1, self.count), smooth[1], wrong), 1)


def gain_and_offset(problem: Problem) -> list[Field]:
    """The fields of the sensor's gain and offset."""
    last = problem.operator.named()[-1][0]
    return [problem.field_of(f"{last}.{slot}") for slot in ("gain", "offset")]


def _variances(field: Field) -> Variances:
    """Prior variances of the pixel, column and row parts of a field."""
    found = {PIXEL: 0.0, COLUMN: 0.0, ROW: 0.0}
    for part in field.parts():
        if not isinstance(part, Shading):
            found[part.constant_axes] += float(part.sigma) ** 2
    return found


def _high_order_lines(field: Field, frame: Shading) -> Tensor:
    """The columns and rows of gain or offset less what is slow of them, (h, w)."""
    lines = [part.values for part in field.parts() if not isinstance(part, Shading) and part.constant_axes]
    values = sum(lines, torch.zeros(1, dtype=torch.float64, device=frame.relative_sigma.device))
    values = values.expand(frame.shape)[0, 0]
    return values - frame.project(values)


def _motion_derivatives(flux: Tensor, step: int) -> Tensor:
    """How frames (N, h, w) change with a shift in x, in y, and a turn about the middle, at some pixels: (N, 3, K)."""
    height, width = flux.shape[1:]
    rows, columns = (slice(1, -1, step),) * 2
    down = (flux[:, 2::step, columns] - flux[:, :-2:step, columns]) / 2
    right = (flux[:, rows, 2::step] - flux[:, rows, :-2:step]) / 2
    y, x = (
        torch.linspace(-side / 2, side / 2, side, dtype=flux.dtype, device=flux.device)[rows]
        for side in (height, width)
    )
    return torch.stack((right, down, x * down - y[:, None] * right), 1).flatten(2)
