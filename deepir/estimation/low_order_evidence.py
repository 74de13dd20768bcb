"""Strengths of low-order parts of the frames by their evidence.

`LowOrderEvidence` compares the low-order parts of the frames, with those of the scene free: shading of the offset and
drift of the level. `GainOffsetEvidence` compares all samples, for a gain that is shaded as well or differs between
frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median, subsample
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.estimation.residuals import has_line_noise, line_noise_fields
from deepir.fields.base import Field
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import WALK_SIGMA_RATIO, Drift
from deepir.fields.shading import Shading
from deepir.operators import Warp
from deepir.operators.motion_models import displacement_at
from deepir.optim.low_order_model import LowOrderModel, Variances, expected_variances, pattern_variances
from deepir.problem import Problem

#: Regularisation of unknowns without a prior, relative to the mean of their diagonal: some are indistinguishable.
IMPROPER_RIDGE = 1e-9
CLIP_MADS = 7.5  # residual at which samples are clipped, in median absolute deviations
#: Fractions of the chance contribution of lines to the low-order parts of a frame that are tried.
LINE_VARIANCE_FRACTIONS = (1.0, 1 / 4, 1 / 16)
#: Standard deviations of further errors of the low-order parts (parallax, distortion) that are tried, data contrasts.
MODEL_ERROR_FRACTIONS = (3e-4, 1e-3, 3e-3, 1e-2)
#: Minimum log Bayes factor, nats, of such a model error: before convergence the scene is slightly wrong, too.
MIN_LOG_BAYES_FACTOR_MODEL_ERROR = 100
#: Minimum log Bayes factor, nats, of shading if the frames have such a model error.
MIN_LOG_BAYES_FACTOR_WITH_ERROR = 200
MIN_LOG_BAYES_FACTOR = 3  # minimum log Bayes factor, nats, of shading or drift
MIN_LOG_BAYES_FACTOR_DRIFT = 5  # minimum log Bayes factor, nats, of drift if shading competes, which is far more common
#: Minimum log Bayes factor, nats, of shading in frames with automatic gain: their levels follow the motion as well.
MIN_LOG_BAYES_FACTOR_AGC = 40
#: Standard deviation of shading with drift, relative to that without, below which the drift is preferred.
MAX_REMAINING_SHADING = 0.8
MIN_SCENE_CHANGE = 0.15  # change of the scene by the drift from which it is preferred, standard deviations of the data
N_SIGMAS = 21, 9  # standard deviations on the axis of the coarse search, and of the fine one an octave to either side
N_GAIN_SIGMAS = 9, 7  # the same on each axis of a search with a shaded gain
MAX_PIXELS = 16_000  # pixels of a frame that are used to find a shaded gain, at most
PIXELS_IN_CACHE = 1000  # pixels of a block whose columns fit into the cache
MAX_ERROR_DEGREE = 2  # degree up to which the low-order parts of a frame may be wrong


class MarginalLikelihood:
    """Marginal likelihood for a negative log-likelihood `½ x' A x - b' x` whose first unknowns have a flat prior.

    Attributes: `system`, the Schur complement of A after integration over the first unknowns; `score`, the
    corresponding part of b; `constant`, nats of that integral.

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
        triangle, _ = torch.linalg.cholesky_ex(one + prior[:, :, None].sqrt() * self.system * prior[:, None].sqrt())
        whitened = torch.linalg.solve_triangular(triangle, (prior.sqrt() * self.score)[..., None], upper=False)
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


class _StrengthEvidence:
    """Marginal likelihood of the standard deviations of several parts."""

    evidence: MarginalLikelihood

    def _prior(self, strengths: Tensor) -> Tensor:
        """Variances of the unknowns with a prior, (K, unknowns), at standard deviations (K, parts)."""
        raise NotImplementedError

    def nats(self, strengths: Tensor) -> Tensor:
        """Negative log marginal likelihood, nats up to a constant, (K,), of standard deviations (K, parts)."""
        return self.evidence.nats(self._prior(strengths))

    def _minimum(self, coarse: Tensor, count: int) -> tuple[float, list[float]]:
        """Fewest nats around the best of `coarse` (K, parts), and its standard deviations; zeros stay."""
        start = coarse[self.nats(coarse).argmin()]
        near = 2 ** torch.linspace(-1, 1, count, dtype=torch.float64)
        finer = start * torch.cartesian_prod(*(near if each > 0 else near[:1] for each in start))
        nats = self.nats(finer)
        return float(nats.min()), finer[nats.argmin()].tolist()


class LowOrderEvidence(_StrengthEvidence):
    """Marginal likelihood of the low-order parts of the frames, those of the scene integrated out under a flat prior.

    Args:
        problem: Its current values give the residuals.
        stray_flux: Fields of stray flux; with these `smooth` stands for stray flux instead of shading.
    """

    def __init__(self, problem: Problem, stray_flux: Sequence[BasisExpansion] = ()) -> None:
        self.low_order = LowOrderModel(problem, tuple(problem.values()["scene"].shape))
        variance = pattern_variances(problem, problem.closed_form())
        self.expected = expected_variances(variance, self.low_order.frame)
        #: Variances of the polynomials for a strength of one.
        self.shape = self.low_order.frame.relative_sigma.square()
        if stray_flux:
            columns = [self.low_order.basis_columns(one)[0][1:] for one in stray_flux]
            self.shape = torch.stack([each.square().sum(1) for each in columns]).sum(0)
        self.jumps = float(frame_level_offsets(problem).square().mean().sqrt())
        residual = _low_order_residual(problem, self.low_order.frame)
        (some,) = subsample(residual[:, None])
        self.count, self.stray_flux = len(residual), stray_flux
        seen = self.low_order.frame_scores(_clipped(residual, some)[0])
        self.contrast = float(contrast(problem))
        known, chance = self._line_noise_variance(), self._line_variance(variance)
        variances = [known + share * chance for share in LINE_VARIANCE_FRACTIONS]
        wrong = () if stray_flux else MODEL_ERROR_FRACTIONS  # stray flux, before it is known, is as much
        variances += [known + chance + (share * self.contrast) ** 2 for share in wrong]
        rare = [0] * len(LINE_VARIANCE_FRACTIONS) + [MIN_LOG_BAYES_FACTOR_MODEL_ERROR] * len(wrong)
        each = [(*self._with_variance(seen, of), nats, of) for of, nats in zip(variances, rare, strict=True)]
        self.low_order, self.evidence, _, odd, self.doubt = min(each, key=lambda found: float(found[2]) + found[3])
        self.min_log_bayes_factor = MIN_LOG_BAYES_FACTOR_WITH_ERROR if odd else MIN_LOG_BAYES_FACTOR

    def _with_variance(self, seen: Tensor, variance: Tensor) -> tuple[LowOrderModel, MarginalLikelihood, Tensor]:
        """The low-order model with this variance per frame, its evidence, and its nats with free shading and drift."""
        model, free = self.low_order.with_frame_variance(variance), len(self.low_order.scene.whitened) + 1
        levels = model.level_columns()
        normal = model.normal_matrix(levels)
        rhs = model.right_hand_side(seen, levels)
        for each in self.stray_flux:  # the residual is without what is known of them
            terms = model.basis_columns(each)[0] @ each.coefficients.double()
            rhs += normal[:, free - 1 : free + len(self.expected)] @ terms
        evidence = MarginalLikelihood(normal, rhs, free)
        nats = evidence.nats(self._prior(self.expected.new_tensor([2 * [self.contrast]])))[0]
        return model, evidence, model.null_nats(seen).cpu() + evidence.constant.cpu() + nats

    def _line_noise_variance(self) -> Tensor:
        """Variance of temporal line noise in the level and the polynomials of a frame, (terms + 1,)."""
        frame = self.low_order.frame
        level = torch.zeros_like(frame.order_y[:1])
        of_y, of_x = torch.cat((level, frame.order_y)), torch.cat((level, frame.order_x))
        found = torch.zeros(len(of_y), dtype=torch.float64, device=of_y.device)
        for field in line_noise_fields(self.low_order.problem):
            constant = (of_x if field.line_axis == -2 else of_y) == 0
            found += constant * field.frame_mean_variance
        return found

    def _line_variance(self, variance: dict[tuple[int, ...], float]) -> float:
        """Variance of what the lines' pattern does to the frames by chance.

        Of the lines at one edge of the view some leave as the camera moves, and as many others enter at the other.
        """
        problem, (height, width) = self.low_order.problem, self.low_order.frame.shape[-2:]
        motion = problem.field_of(problem.slot(Warp, "motion"))().detach().double()
        shifts = displacement_at(motion, motion.new_zeros(2))
        moved = (shifts - shifts.mean(0)).abs().mean(0)
        columns = 2 * float(moved[0]) / width * variance[COLUMN] / width
        return columns + 2 * float(moved[1]) / height * variance[ROW] / height

    def most_likely(self, *, smooth: bool, drift: bool) -> tuple[float, float]:
        """Standard deviations (shading, drift) of maximum marginal likelihood, data units.

        Of shading where it is a candidate (`smooth`), and of drift likewise; zero without sufficient evidence.
        """
        coarse, fine = N_SIGMAS
        grid = self.contrast * torch.logspace(-4.5, 0.5, coarse, dtype=torch.float64)
        # Levels that jump drift by as much, and what was known of the jumps already follows slopes.
        levels = grid.new_tensor([self.jumps / WALK_SIGMA_RATIO]) if self.jumps else grid
        used = torch.cartesian_prod(torch.arange(1 + smooth), torch.arange(int(drift and self.jumps > 0), 1 + drift))
        best = []
        for each in used:
            some = (of if one else grid.new_zeros(1) for one, of in zip(each, (grid, levels), strict=True))
            best.append(self._minimum(torch.cartesian_prod(*some), fine))
        nats = dict(zip(map(tuple, used.tolist()), (each for each, _ in best), strict=True))
        shaded = nats.get((1, 0), math.inf) + self.min_log_bayes_factor < nats.get((0, 0), math.inf)
        gains_vary = self.low_order.problem.agc and not self.low_order.problem.gains_are_equal
        rare = [self.min_log_bayes_factor, MIN_LOG_BAYES_FACTOR_DRIFT if shaded else MIN_LOG_BAYES_FACTOR]
        if gains_vary:
            rare = [MIN_LOG_BAYES_FACTOR_AGC, MIN_LOG_BAYES_FACTOR]
        asked = torch.tensor(list(nats.values())) + used @ torch.tensor(rare, dtype=torch.long)
        found = best[int(asked.argmin())][1]
        if drift and not gains_vary and not found[1]:
            drifting = best[int(asked.where(used[:, 1] > 0, math.inf).argmin())][1]
            # A slope of the sensor, and one of the scene the other way, are there to explain the levels alone.
            if drifting[0] < MAX_REMAINING_SHADING * found[0]:
                change = self.low_order_scene(*found) - self.low_order_scene(*drifting)
                if float(change.std()) / self.contrast > MIN_SCENE_CHANGE:
                    found = drifting
        return found[0], found[1]

    def profile(self, smooth: Tensor, *, drift: bool) -> tuple[Tensor, Tensor]:
        """Nats (K,) of strengths of the shading (K,), each with the likeliest drift, and that drift (K,)."""
        levels = self.contrast * torch.logspace(-4.5, 0.5, N_SIGMAS[0], dtype=torch.float64)
        levels = torch.cat((levels.new_zeros(1), levels)) if drift else levels.new_zeros(1)
        nats = self.nats(torch.cartesian_prod(smooth, levels).reshape(-1, 2)).view(len(smooth), -1).cpu()
        best = (nats + MIN_LOG_BAYES_FACTOR * (levels > 0)).min(1)
        return best.values, levels[best.indices]

    def _prior(self, strengths: Tensor) -> Tensor:
        """Variances of φ and of the levels, (K, terms + N)."""
        smooth, drift = strengths.to(self.expected.device).square().split(1, 1)
        return torch.cat((self.expected + smooth * self.shape, drift.expand(-1, self.count)), 1)

    def _posterior(self, smooth: float, drift: float) -> tuple[Tensor, Tensor]:
        """Means of (θ, level of the pattern) and of (φ, levels)."""
        (prior,) = self._prior(self.expected.new_tensor([[smooth, drift]]))
        return self.evidence.posterior(prior)

    def levels(self, smooth: float, drift: float) -> Tensor:
        """Posterior mean of the frame levels, (N, 1, 1, 1), data units."""
        found = self.low_order.level_columns()[:, 0] @ self._posterior(smooth, drift)[1][-self.count :]
        return found[:, None, None, None]

    def low_order_pattern(self, smooth: float, drift: float) -> Tensor:
        """Posterior mean of the low-order pattern, (h, w)."""
        return self.low_order.frame.synthesise(self._posterior(smooth, drift)[1][: -self.count])

    def low_order_scene(self, smooth: float, drift: float) -> Tensor:
        """Posterior mean of the low-order correction of the scene, on its grid."""
        return self.low_order.scene.synthesise(self._posterior(smooth, drift)[0][:-1])


class GainOffsetEvidence(_StrengthEvidence):
    """Marginal likelihood of standard deviations (offset's shading, drift, gain's shading), jointly with the scene.

    Frame k is `(1 + γ) z_k + φ + l_k` with low-order gain γ and offset φ, plus the pattern of pixels. A scene estimated
    without γ has absorbed part of it: it may be wrong by low-order factors ψ and sums θ, which the motion transports,
    `z_k T_k ψ + T_k θ`, and the motion may be slightly wrong. With these free and the pixel pattern integrated out, the
    marginal likelihood of φ, l and γ is that of a Gaussian with some forty unknowns. Texture that fades towards the
    corners identifies γ. Frames may have gains of their own, about the middle of the data.

    Args:
        problem: Its current values give the residuals.
        frame_gains: Whether frames have free gains.
        doubt: Variances of further errors of the low-order parts of a frame, (terms + 1,); degrees up to
            `MAX_ERROR_DEGREE` count.
    """

    def __init__(self, problem: Problem, *, frame_gains: bool = False, doubt: Tensor | None = None) -> None:
        values, flux = problem.optimum()
        self.low_order = LowOrderModel(problem, tuple(values["scene"].shape))
        frame = self.low_order.frame
        self.low = (frame.order_y + frame.order_x <= MAX_ERROR_DEGREE) & (doubt is not None)
        self.doubt = frame.relative_sigma[self.low] if doubt is None else doubt[1:][self.low]  # none, or some
        step = math.ceil((flux[0].numel() / MAX_PIXELS) ** 0.5)
        some = (slice(1, -1, step),) * 2
        seen = flux, problem.data - frame_level_offsets(problem), problem.fitted()
        self.shape = flux[0, 0, *some].shape
        z, data, precision = (each[:, 0, *some].flatten(1) for each in seen)
        self.level = float(z.double().square().mean().sqrt())
        self.spread = float(masked_values(data, precision > 0).std())
        fields = [problem.fields[name] for name in problem.gain_and_offset()]
        of_gain, of_offset = map(_variances, fields)
        gain, offset = (_high_order_lines(field, frame)[some].to(flux).flatten() for field in fields)
        residual = data - (1 + gain) * z - offset
        pixels = self.level**2 * of_gain.pop(PIXEL), of_offset.pop(PIXEL)
        self.expected = [
            expected_variances({PIXEL: 0.0} | lines, frame) * unit
            for lines, unit in ((of_offset, 1.0), (of_gain, self.level**2))
        ]
        residual, middle = _clipped(residual, masked_values(residual, precision > 0))
        residual += middle
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
        for *block, block_precision, pixel_columns in zip(*(each.split(count, -1) for each in maps), strict=True):
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
                maps = columns.unflatten(1, self.shape)
                for field in line_noise_fields(self.low_order.problem):
                    if field.sigma > 0:
                        maps = maps - maps.mean(-3 - field.line_axis, keepdim=True)
                columns = maps.flatten(1)
            yield columns

    def best(self, *, shaded: bool, drift: bool) -> tuple[float, list[float]]:
        """Fewest nats, and their standard deviations (offset's shading, drift, gain's shading).

        Of the negative log marginal likelihood, with shading of the gain where it is a candidate (`shaded`), and drift
        likewise, at the cost of `MIN_LOG_BAYES_FACTOR_DRIFT` nats.
        """
        coarse, fine = N_GAIN_SIGMAS
        grid = self.spread * torch.logspace(-3.5, 0.5, coarse, dtype=torch.float64)
        zero = grid.new_zeros(1)
        gains = torch.logspace(-3, -0.5, coarse, dtype=torch.float64) if shaded else zero
        found = []
        for drifts in (False, True)[: 1 + drift]:
            nats, best = self._minimum(torch.cartesian_prod(grid, grid if drifts else zero, gains), fine)
            found.append((nats + MIN_LOG_BAYES_FACTOR_DRIFT * drifts, best))
        return min(found)

    def frame_gains(self) -> Tensor:
        """Most likely frame gains (N,), mean one, with drifting levels and no gain shading."""
        _, strengths = self.best(shaded=False, drift=True)
        free, _ = self.evidence.posterior(self._prior(torch.tensor([strengths], dtype=torch.float64))[0])
        found = self.low_order.level_columns()[:, 0, 1:] @ free[1 - self.count :]
        return 1 + found / self.spread

    def _prior(self, strengths: Tensor) -> Tensor:
        """Variances of φ, levels and γ, (K, unknowns)."""
        offset, drift, gain = strengths.square().T[..., None]
        shape = self.low_order.frame.relative_sigma.square().cpu()
        of_offset, of_gain = (each.cpu() for each in self.expected)
        smooth = of_offset + offset * shape, of_gain + self.level**2 * gain * shape
        wrong = self.doubt.cpu().repeat(self.count).expand(len(drift), -1)
        return torch.cat((smooth[0], drift.expand(-1, self.count), smooth[1], wrong), 1)


def _low_order_residual(problem: Problem, frame: Shading) -> Tensor:
    """Frames less the scene and the high-order pattern, (N, h, w)."""
    closed = problem.closed_form()
    values, flux = problem.optimum()
    high_order = []
    for name, neutral in zip(problem.sensor_unknowns().values(), (1.0, 0.0), strict=False):
        value = values[name]
        if name in closed:
            value = value - frame.project((value - neutral)[0, 0].double()).to(value)
        high_order.append(value)
    gain, offset = high_order
    return torch.addcmul(problem.data - offset - frame_level_offsets(problem), gain, flux, value=-1)[:, 0]


def _clipped(residual: Tensor, some: Tensor) -> tuple[Tensor, float]:
    """Residuals less the median of `some` of them, clipped; and that median."""
    middle = median(some)
    limit = CLIP_MADS * median((some - middle).abs())
    return (residual - middle).clamp(-limit, limit), middle


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


def frame_level_offsets(problem: Problem) -> Tensor:
    """Known levels of the frames, (N, 1, 1, 1); (1, 1, 1, 1) without any."""
    found = [module.level_offsets for module in problem.modules() if isinstance(module, Drift)]
    return sum(found, problem.data.new_zeros(1, 1, 1, 1))


def contrast(problem: Problem) -> Tensor:
    """Standard deviation of the samples that count, a scalar."""
    data, precision = subsample(problem.data, problem.precision)
    return masked_values(data, precision > 0).std()
