"""What is slow over the frame: polynomials of the scene and of the pattern, and the levels of whole frames.

A camera that moves by `d` over a slope of the sensor sees its level change by a multiple of `d`, as if it drifted; over
a quadratic offset it sees frames that slope against each other. Which of them there is, and how strong, is asked of
the evidence: how likely the frames' slow parts are, whatever the scene's are.

In each frame the slow part is `c_j = T_j θ + φ + l_j`: coefficients of polynomials of the scene θ, which the motion
carries into the frame, and of the pattern φ, the same in all frames, and the level l_j in the first of them, which is
constant. All that the data say of them is a matrix `M_j` and a vector `q_j` for each frame: `½ c' M c - q' c` nats.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from itertools import product
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.elimination import COLUMN, PIXEL, ROW
from deepir.operators.warp import Warp, coords
from deepir.priors.drift import Drift
from deepir.priors.motion import Motion
from deepir.priors.shading import Shading
from deepir.problem import Problem, Values
from deepir.thin import thinned

POINTS = 40  # along each axis, where the polynomials are sampled
OUTLIER = 7.5  # medians of the residuals' size at which they are cut off
ENOUGH = 4  # frames to tell shading from the scene
CERTAIN = 5.0  # nats by which shading or drift have to make the frames likelier
RARE = 15.0  # the same of a drift where it may be shading, which is far more common
SMOOTH = (-1, 1)  # no axes: the polynomials of a shading


class Slow:
    """The slow parts of a burst, whose scene is seen through a warp.

    `scene`: a shading whose polynomials are over the canvas, `frame`: over a frame; `carried` (N, terms + 1, terms):
    T_j; `information` (N, terms + 1, terms + 1): M_j.
    """

    def __init__(self, problem: Problem, canvas: tuple[int, ...]) -> None:
        warp: Any = problem.operator.named()[0][1]
        device = problem.data.device
        height, width = warp.size
        self.problem = problem
        self.scene, self.frame = (
            Shading((1, 1, *size)).to(device) for size in (canvas[-2:], (height, width))
        )
        step_y, step_x = max(height // POINTS, 1), max(width // POINTS, 1)
        motion = problem.values()[problem.slots["warp.motion"]].double()
        points = coords(warp.place @ motion, warp.size)[:, ::step_y, ::step_x].flatten(1, 2)
        y, x = torch.meshgrid(
            torch.arange(height, dtype=torch.float64, device=device)[::step_y] - (height - 1) / 2,
            torch.arange(width, dtype=torch.float64, device=device)[::step_x] - (width - 1) / 2,
            indexing="ij",
        )
        terms = self.frame.at(y.flatten(), x.flatten())
        terms = torch.cat((torch.ones_like(terms[:, :1]), terms), 1)
        seen = self.scene.at(points[..., 1], points[..., 0])
        self.carried = torch.linalg.lstsq(terms.expand(len(seen), *terms.shape), seen).solution
        weights = problem.fitted()[:, 0, ::step_y, ::step_x].double().flatten(1)
        area = height * width / weights.shape[1]
        self.information = area * terms.T @ (weights[..., None] * terms)
        self.kept = torch.eye(terms.shape[1], dtype=terms.dtype, device=device).expand_as(self.information)

    def doubt(self, variance: float) -> None:
        """Take from the information what the slow parts of each frame vary by chance, independently."""
        self.kept = torch.linalg.inv(self.kept + variance * self.information)
        self.information = self.kept @ self.information

    def normal(self, *, levels: bool) -> Tensor:
        """Normal matrix of (θ, level of the pattern, φ, levels of the frames)."""
        maps = self._maps(levels=levels)
        return (maps.mT @ self.information @ maps).sum(0)

    def score(self, residual: Tensor, *, levels: bool) -> Tensor:
        """The right-hand side to it, of what the frames (N, h, w) are above their prediction without slow parts."""
        weighted = (self.problem.fitted()[:, 0] * residual).double()
        seen = torch.cat((weighted.sum((1, 2))[:, None], self.frame.sums(weighted)), 1)
        return (self._maps(levels=levels).mT @ self.kept @ seen[..., None]).sum(0)[:, 0]

    def _maps(self, *, levels: bool) -> Tensor:
        """Of all unknowns, (N, terms + 1, unknowns): what they make of each frame's slow part."""
        count, size, _ = self.carried.shape
        one = torch.eye(size, dtype=self.carried.dtype, device=self.carried.device).expand(count, size, size)
        if not levels:
            return torch.cat((self.carried, one), 2)
        each = torch.eye(count, dtype=one.dtype, device=one.device) - 1 / count
        each = torch.cat((each[:, None], one.new_zeros(count, size - 1, count)), 1)
        return torch.cat((self.carried, one, each), 2)


def variances(problem: Problem, eliminated: Collection[str]) -> dict[tuple[int, ...], float]:
    """Variance of the free pattern in the data's units, by the axes along which it is constant."""
    data, precision = thinned(problem.data, problem.precision)
    level = float(data[precision > 0].square().mean().sqrt())
    found = {PIXEL: 0.0, COLUMN: 0.0, ROW: 0.0, SMOOTH: 0.0}
    for kind, unit in (("gain", level), ("offset", 1.0)):
        name = problem.slots.get(f"{problem.operator.named()[-1][0]}.{kind}", "")
        for part in problem.fields[name].parts() if name in eliminated else ():
            found[SMOOTH if isinstance(part, Shading) else part.along] += (float(part.sigma) * unit) ** 2
    return found


def expected(variance: dict[tuple[int, ...], float], frame: Shading) -> Tensor:
    """Variance of each of the frame's polynomials in a pattern of these variances, shading left out."""
    height, width = frame.shape[-2:]
    each = torch.full((len(frame.white),), variance[PIXEL] / (height * width), dtype=torch.float64)
    each = each.to(frame.of_y.device)
    return each + (frame.of_y == 0) * variance[COLUMN] / width + (frame.of_x == 0) * variance[ROW] / height


@torch.no_grad()
def estimate_slow(problem: Problem, *, start: bool = False) -> None:
    """Set the strengths of shading and drift as the evidence has them; with `start` the levels and the scene too."""
    shadings, drifts = _unknown(problem)
    if not (shadings or drifts):
        return
    evidence = _Evidence(problem, problem.closed_form())
    smooth, drift = evidence.most_likely(smooth=bool(shadings), drift=bool(drifts))
    if smooth and len(problem.data) < ENOUGH:  # then a drift is not told from it either
        smooth = drift = 0.0
    for part in shadings:
        part.sigma.fill_(smooth)
    for field in drifts:
        field.sigma.fill_(drift)
        if start:
            field.step.copy_(problem.data[problem.precision > 0].std() / problem.data[0].numel() ** 0.5)
            field.init_from(evidence.levels(smooth, drift))
    if start:
        scene = problem.fields["scene"]
        scene.init_from(scene() + evidence.slow_scene(smooth, drift).to(problem.data))


@torch.no_grad()
def shading_message(problem: Problem) -> list[str]:
    """Say so if too few frames are shaded."""
    shadings, drifts = _unknown(problem)
    if not shadings or len(problem.data) >= ENOUGH:
        return []
    smooth, _ = _Evidence(problem, problem.closed_form()).most_likely(smooth=True, drift=bool(drifts))
    if not smooth:
        return []
    return [
        f"the frames are shaded, which {len(problem.data)} of them do not tell from the scene: it is left in. "
        f"Take {ENOUGH} or more"
    ]


def _unknown(problem: Problem) -> tuple[list[Shading], list[Drift]]:
    """Shadings of the offset and drifts whose strengths are to be found; none unless a warp makes the frames."""
    first = problem.operator.named()[0][1]
    if not isinstance(first, Warp) or first.size != problem.data.shape[-2:] or len(problem.data) < 2:
        return [], []
    closed, free = problem.closed_form(), problem.free()
    offsets = [name for slot, name in problem.slots.items() if slot.endswith(".offset") and name in closed]
    parts = [part for name in offsets for part in problem.fields[name].parts()]
    fields = [problem.fields[name] for name in free]
    return (
        [part for part in parts if isinstance(part, Shading) and not part.given],
        [field for field in fields if isinstance(field, Drift) and not field.given],
    )


class _Evidence:
    """How likely the slow parts of the frames are, for strengths (shading, drift); the scene's may be anything."""

    def __init__(self, problem: Problem, eliminated: Collection[str]) -> None:
        values = problem.values()
        self.slow = Slow(problem, tuple(values["scene"].shape))
        variance = variances(problem, eliminated)
        self.expected = expected(variance, self.slow.frame)
        self.slow.doubt(self._chance(variance))
        residual = _slow_residual(problem, values, self.slow.frame)
        (some,) = thinned(residual[:, None])
        middle = some.median()
        limit = OUTLIER * float((some - middle).abs().median())
        self.count, self.free = len(residual), len(self.slow.scene.white) + 1
        self.normal = self.slow.normal(levels=True)
        self.rhs = self.slow.score((residual - middle).clamp(-limit, limit), levels=True)
        a, b = self.normal[: self.free, : self.free], self.normal[: self.free, self.free :]
        a = a + 1e-9 * a.diagonal().mean() * torch.eye(self.free, dtype=a.dtype, device=a.device)
        self.back = torch.linalg.solve(a, torch.cat((b, self.rhs[: self.free, None]), 1))
        self.system = self.normal[self.free :, self.free :] - b.T @ self.back[:, :-1]
        self.score = self.rhs[self.free :] - b.T @ self.back[:, -1]

    def _chance(self, variance: dict[tuple[int, ...], float]) -> float:
        """Variance of what the lines' pattern does to the frames by chance.

        Of the lines at one edge of the view some leave as the camera moves, and as many others enter at the other.
        """
        height, width = self.slow.frame.shape[-2:]
        moved = shifts(self.slow.problem).abs().mean(0)
        columns = 2 * float(moved[0]) / width * variance[COLUMN] / width
        return columns + 2 * float(moved[1]) / height * variance[ROW] / height

    def most_likely(self, *, smooth: bool, drift: bool) -> tuple[float, float]:
        """Strengths of shading and drift; zero for what makes the frames not by `CERTAIN` nats, or `RARE`, likelier."""
        scale = float(self.slow.problem.data[self.slow.problem.precision > 0].std())
        none, found = self.nats(0.0, 0.0), {}
        for mine in product(*((False, True) if each else (False,) for each in (smooth, drift))):
            if any(mine):
                found[mine] = min(self._descend(mine, start * scale) for start in (0.003, 0.03))
        shaded = (True, False) in found and found[True, False][0] + CERTAIN < none
        asked = CERTAIN, (RARE if shaded else CERTAIN)
        weighed = [
            (nats + sum(each for each, used in zip(asked, mine, strict=True) if used), at)
            for mine, (nats, at) in found.items()
        ]
        return min([(none, (0.0, 0.0)), *weighed])[1]

    def _descend(self, free: tuple[bool, ...], start: float) -> tuple[float, tuple[float, float]]:
        def at(x: np.ndarray) -> tuple[float, float]:
            given: Iterator[float] = iter(np.exp(x))
            smooth, drift = (float(next(given)) if each else 0.0 for each in free)
            return smooth, drift

        lowest = math.log(1e-3 * start)
        found = minimize(
            lambda x: self.nats(*at(x)),
            [math.log(start)] * sum(free),
            method="L-BFGS-B",
            bounds=[(lowest, lowest + 14)] * sum(free),
        )
        return float(found.fun), at(found.x)

    def nats(self, smooth: float, drift: float) -> float:
        """Minus the evidence's logarithm, up to a constant."""
        prior = self._prior(smooth, drift)
        system = torch.eye(len(prior), dtype=prior.dtype, device=prior.device) + prior[:, None] * self.system
        mean = torch.linalg.solve(system, prior * self.score)
        return float(torch.linalg.slogdet(system).logabsdet - mean @ self.score) / 2

    def _prior(self, smooth: float, drift: float) -> Tensor:
        """Variances of φ and of the levels."""
        return torch.cat((self.expected + smooth**2, self.expected.new_full((self.count,), drift**2)))

    def _posterior(self, smooth: float, drift: float) -> tuple[Tensor, Tensor]:
        """Means of (θ, level of the pattern) and of (φ, levels)."""
        prior = self._prior(smooth, drift)
        system = torch.eye(len(prior), dtype=prior.dtype, device=prior.device) + prior[:, None] * self.system
        mean = torch.linalg.solve(system, prior * self.score)
        return self.back[:, -1] - self.back[:, :-1] @ mean, mean

    def levels(self, smooth: float, drift: float) -> Tensor:
        """The levels of the frames, (N, 1, 1, 1)."""
        found = self._posterior(smooth, drift)[1][-self.count :]
        return (found - found.mean())[:, None, None, None]

    def slow_scene(self, smooth: float, drift: float) -> Tensor:
        """What the scene lacks, on its grid."""
        return self.slow.scene.spread(self._posterior(smooth, drift)[0][:-1])


def _slow_residual(problem: Problem, values: Values, frame: Shading) -> Tensor:
    """The frames, (N, h, w), less the scene and all of the pattern that is not slow."""
    closed = problem.closed_form()
    values = dict(values)
    problem.eliminate(values, closed)
    quick = {}
    for kind, neutral in (("gain", 1.0), ("offset", 0.0)):
        name = problem.slots[f"{problem.operator.named()[-1][0]}.{kind}"]
        quick[kind] = values[name]
        if name in closed:
            own = (values[name] - neutral)[0, 0].double()
            slow = own.mean() + frame.spread(frame.sums(own) / own.numel())
            quick[kind] = quick[kind] - slow.to(quick[kind])
    return (problem.data - quick["gain"] * problem.flux(values) - quick["offset"])[:, 0]


def shifts(problem: Problem) -> Tensor:
    """Translation (x, y) of each frame, (N, 2) float64, less their mean; zero without motion."""
    values = [field() for name in problem.slots.values() if isinstance(field := problem.fields[name], Motion)]
    if not values:
        return problem.data.new_zeros(len(problem.data), 2).double()
    moved = values[0][:, :2, 2].detach().double()
    return moved - moved.mean(0)
