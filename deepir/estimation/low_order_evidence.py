"""How likely what is slow over the frame is, for strengths of shading and drift."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median, subsample
from deepir.closed_form.variable_projection import COLUMN, ROW
from deepir.estimation.line_levels import line_noise_in_polynomials
from deepir.estimation.marginal_likelihood import MarginalLikelihood
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import WALK_SIGMA_RATIO, Drift
from deepir.fields.shading import Shading
from deepir.operators.homography import displacement_at
from deepir.optim.low_order_model import LowOrderModel, expected_variances, pattern_variances
from deepir.problem import Problem, Values

OUTLIER = 7.5  # medians of the residuals' size at which they are cut off
SHARES = (1.0, 1 / 4, 1 / 16)  # of what lines may do to the frames by chance
#: Standard deviations, as shares of the contrast, of what else frames' slow parts may be wrong by: parallax, a lens.
WRONG = (3e-4, 1e-3, 3e-3, 1e-2)
CLEARLY = 100  # nats by which that has to make the frames likelier: a scene that has not settled is a little wrong, too
SUSPECT = 200  # nats by which shading has to make frames likelier that are wrong by more than lines make them
CERTAIN = 3  # nats by which shading or drift have to make the frames likelier
RARE = 5  # the same of a drift where it may be shading, which is far more common,
#: Share of the shading's strength that a drift may leave, and standard deviations of the data by which it unbends the
#: scene, from which there is one.
REPLACED, SLOPING = 0.8, 0.15
FOLLOWS = 40  # and of shading in stretched pictures: their levels follow the motion, as if it were shading


class LowOrderEvidence:
    """How likely the slow parts of the frames are, for strengths (shading, drift); the scene's may be anything."""

    def __init__(
        self, problem: Problem, eliminated: Collection[str], strays: Sequence[BasisExpansion] = ()
    ) -> None:
        values = problem.values()
        self.low_order = LowOrderModel(problem, tuple(values["scene"].shape))
        variance = pattern_variances(problem, eliminated)
        self.expected = expected_variances(variance, self.low_order.frame)
        #: Variances of the polynomials for a strength of one.
        self.shape = self.low_order.frame.relative_sigma.square()
        if strays:
            self.shape = torch.stack(
                [self.low_order.basis_columns(one)[0][1:].square().sum(1) for one in strays]
            ).sum(0)
        self.jumps = float(frame_level_offsets(problem).square().mean().sqrt())
        residual = _slow_residual(problem, values, self.low_order.frame)
        (some,) = subsample(residual[:, None])
        middle = median(some)
        limit = OUTLIER * median((some - middle).abs())
        self.count, self.strays = len(residual), strays
        seen = self.low_order.frame_scores((residual - middle).clamp(-limit, limit))
        self.contrast = float(contrast(problem))
        known, chance = line_noise_in_polynomials(problem, self.low_order.frame), self._chance(variance)
        doubts = [known + share * chance for share in SHARES]
        wrong = () if strays else WRONG  # stray flux, before it is known, is as much
        doubts += [known + chance + (share * self.contrast) ** 2 for share in wrong]
        rare = [0] * len(SHARES) + [CLEARLY] * len(wrong)
        each = [(*self._doubted(seen, of), nats, of) for of, nats in zip(doubts, rare, strict=True)]
        self.low_order, self.evidence, _, odd, self.doubt = min(
            each, key=lambda found: float(found[2]) + found[3]
        )
        self.certain = SUSPECT if odd else CERTAIN

    def _doubted(self, seen: Tensor, variance: Tensor) -> tuple[LowOrderModel, MarginalLikelihood, Tensor]:
        """What is slow if so much of it varies by chance, its evidence, and its nats, shading and drift free."""
        slow, free = self.low_order.with_frame_variance(variance), len(self.low_order.scene.whitened) + 1
        levels = slow.level_columns()
        normal = slow.normal_matrix(levels)
        rhs = slow.right_hand_side(seen, levels)
        for each in self.strays:  # the residual is without what is known of them
            terms = slow.basis_columns(each)[0] @ each.coefficients.double()
            rhs += normal[:, free - 1 : free + len(self.expected)] @ terms
        evidence = MarginalLikelihood(normal, rhs, free)
        nats = evidence.nats(self._prior(self.expected.new_tensor([2 * [self.contrast]])))[0]
        return slow, evidence, slow.null_nats(seen).cpu() + evidence.constant.cpu() + nats

    def _chance(self, variance: dict[tuple[int, ...], float]) -> float:
        """Variance of what the lines' pattern does to the frames by chance.

        Of the lines at one edge of the view some leave as the camera moves, and as many others enter at the other.
        """
        height, width = self.low_order.frame.shape[-2:]
        moved = shifts(self.low_order.problem).abs().mean(0)
        columns = 2 * float(moved[0]) / width * variance[COLUMN] / width
        return columns + 2 * float(moved[1]) / height * variance[ROW] / height

    def most_likely(self, *, smooth: bool, drift: bool) -> tuple[float, float]:
        """Strengths of shading and drift; zero for what makes the frames not by `CERTAIN` nats, or `RARE`, likelier."""
        grid = self.contrast * torch.logspace(-4.5, 0.5, 21, dtype=torch.float64)
        # Levels that jump drift by as much, and what was known of the jumps already follows slopes.
        levels = grid.new_tensor([self.jumps / WALK_SIGMA_RATIO]) if self.jumps else grid
        used = torch.cartesian_prod(
            torch.arange(1 + smooth), torch.arange(int(drift and self.jumps > 0), 1 + drift)
        )
        best = []
        for each in used:
            some = (of if one else grid.new_zeros(1) for one, of in zip(each, (grid, levels), strict=True))
            best.append(self._best(each, torch.cartesian_prod(*some)))
        nats = dict(zip(map(tuple, used.tolist()), (float(each) for each, _ in best), strict=True))
        shaded = nats.get((1, 0), math.inf) + self.certain < nats.get((0, 0), math.inf)
        stretched = self.low_order.problem.stretched and not self.low_order.problem.even
        rare = [FOLLOWS, CERTAIN] if stretched else [self.certain, RARE if shaded else CERTAIN]
        asked = torch.tensor(list(nats.values())) + used @ torch.tensor(rare, dtype=torch.long)
        found = best[int(asked.argmin())][1].tolist()
        if drift and not stretched and not found[1]:
            drifting = best[int(asked.where(used[:, 1] > 0, math.inf).argmin())][1].tolist()
            # A slope of the sensor, and one of the scene the other way, are there to explain the levels alone.
            if drifting[0] < REPLACED * found[0] and self._apart(found, drifting) > SLOPING:
                found = drifting
        return found[0], found[1]

    def _apart(self, one: Sequence[float], other: Sequence[float]) -> float:
        """How far apart scenes are at two strengths (shading, drift), in standard deviations of the data."""
        return float((self.slow_scene(*one) - self.slow_scene(*other)).std()) / self.contrast

    def _best(self, used: Tensor, strengths: Tensor) -> tuple[Tensor, Tensor]:
        """Nats and strengths (shading, drift) of the best of `strengths` (K, 2), and then of those about it."""
        coarse = strengths[self.nats(strengths).argmin()]
        near = 2 ** torch.linspace(-1, 1, 9, dtype=torch.float64)
        finer = coarse * torch.cartesian_prod(*(near if one else near.new_ones(1) for one in used))
        nats = self.nats(finer)
        return nats.min(), finer[nats.argmin()]

    def nats(self, strengths: Tensor) -> Tensor:
        """Minus the evidence's logarithm, up to a constant, of strengths (K, 2) of shading and drift."""
        return self.evidence.nats(self._prior(strengths.to(self.expected.device)))

    def _prior(self, strengths: Tensor) -> Tensor:
        """Variances of φ and of the levels, (K, terms + N)."""
        smooth, drift = strengths[:, :1].square(), strengths[:, 1:].square()
        return torch.cat((self.expected + smooth * self.shape, drift.expand(-1, self.count)), 1)

    def _posterior(self, smooth: float, drift: float) -> tuple[Tensor, Tensor]:
        """Means of (θ, level of the pattern) and of (φ, levels)."""
        (prior,) = self._prior(self.expected.new_tensor([[smooth, drift]]))
        return self.evidence.posterior(prior)

    def levels(self, smooth: float, drift: float) -> Tensor:
        """The levels of the frames, (N, 1, 1, 1)."""
        found = self.low_order.level_columns()[:, 0] @ self._posterior(smooth, drift)[1][-self.count :]
        return found[:, None, None, None]

    def slow_pattern(self, smooth: float, drift: float) -> Tensor:
        """What is slow of the pattern, (h, w)."""
        return self.low_order.frame.synthesise(self._posterior(smooth, drift)[1][: -self.count])

    def slow_scene(self, smooth: float, drift: float) -> Tensor:
        """What the scene lacks, on its grid."""
        return self.low_order.scene.synthesise(self._posterior(smooth, drift)[0][:-1])


def _slow_residual(problem: Problem, values: Values, frame: Shading) -> Tensor:
    """The frames, (N, h, w), less the scene and all of the pattern that is not slow."""
    closed = problem.closed_form()
    values, flux = dict(values), problem.flux(values)
    problem.eliminate(values, closed, flux=flux)
    quick = {}
    for kind, neutral in (("gain", 1.0), ("offset", 0.0)):
        name = problem.slots[f"{problem.operator.named()[-1][0]}.{kind}"]
        quick[kind] = values[name]
        if name in closed:
            own = (values[name] - neutral)[0, 0].double()
            quick[kind] = quick[kind] - frame.project(own).to(quick[kind])
    return torch.addcmul(
        problem.data - quick["offset"] - frame_level_offsets(problem), quick["gain"], flux, value=-1
    )[:, 0]


def frame_level_offsets(problem: Problem) -> Tensor:
    """Known levels of the frames, (N, 1, 1, 1) or as one."""
    found = [module.level_offsets for module in problem.modules() if isinstance(module, Drift)]
    return sum(found, problem.data.new_zeros(1, 1, 1, 1))


def shifts(problem: Problem) -> Tensor:
    """Translation (x, y) of each frame, (N, 2) float64, less their mean; zero without motion."""
    values = [field() for name in problem.slots.values() if (field := problem.fields[name]).model]
    if not values:
        return problem.data.new_zeros(len(problem.data), 2).double()
    moved = displacement_at(values[0].detach().double(), problem.data.new_zeros(2).double())
    return moved - moved.mean(0)


def contrast(problem: Problem) -> Tensor:
    """Standard deviation of the data."""
    data, precision = subsample(problem.data, problem.precision)
    return masked_values(data, precision > 0).std()
