"""Weights of penalties by cross-validation on held-out samples.

Neither the noise nor the number of frames determines how strong a prior should be where the data leave an unknown open.
A search consists of short stages, each with one weight; its table is a buffer of the problem, so that a resumed solve
continues it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepir.estimation.prior_weight import penalties_of, weigh_scene, weigh_unknown
from deepir.joint_problem import AnyProblem
from deepir.optim import objective
from deepir.schedule import Stage, Step

N_TRIALS = 7  # number of weights that are tried
#: First step of the search in log2 of the weight; also where it starts, from above: detail appears faster than it goes.
COARSE_STEP = 2.0
FINE_STEP = 1.0  # second step of the search, in log2 of the weight
#: Largest log2 of the weight: with an inaccurate sensor an oversmoothed scene may predict best and would remain.
MAX_LOG2_WEIGHT = 3.0
#: Samples of one frame that are held out over all frames: few do not show what detail the data leave.
HELD_OUT_SHARE = 0.1
SCENE = "scene"


@dataclass(frozen=True)
class WeightSearch:
    """The search for the weights of the penalties of the scenes, or of another unknown.

    Args:
        unknown: Its name; `scene` stands for all scenes.
        first: Log2 of the first weight, relative to that which the noise suggests.
        least: Smallest log2 of a weight.
        iterations: Most iterations of a trial.
        restart: Whether each trial starts from the value of the first, rather than from that of the one before: where
            much is undetermined, a rough value does not become smooth again within one trial.
    """

    unknown: str = SCENE
    first: float = COARSE_STEP
    least: float = -math.inf
    iterations: int = 10
    restart: bool = False

    def start(self, problem: AnyProblem) -> None:
        """Register the buffers of the search: log2 of each weight and its misfit, nats; where a trial starts."""
        problem.register_buffer(self._table, torch.full((N_TRIALS, 2), torch.nan, dtype=torch.float64))
        for name in self._unknowns(problem) if self.restart else ():
            problem.register_buffer(f"start_{name}", torch.zeros_like(problem.fields[name]().detach()))

    def stages(self, problem: AnyProblem) -> list[Stage]:
        """The trials; none if there is no penalty, or if a weight is given."""
        names = self._unknowns(problem)
        penalties = [each for name in names for each in penalties_of(problem, name)]
        if not penalties or any(penalty.user_weight is not None for penalty in penalties):
            return []
        prefix = "weight" if self.unknown == SCENE else f"weight of {self.unknown}"
        prepare = functools.partial(WeightSearch._begin, self)
        return [Stage(f"{prefix} {i + 1}", (Step(names),), self.iterations, prepare=prepare) for i in range(N_TRIALS)]

    def weigh(self, problem: AnyProblem, factor: float = 1.0) -> None:
        """Set the weights to `factor` times the best of the trials; without trials, times what the noise suggests."""
        misfits = self._recorded(problem)
        self._weigh(problem, factor * (2 ** best_log2_weight(misfits) if misfits else 1.0))

    @torch.no_grad()
    def reset(self, problem: AnyProblem) -> None:
        """Put the unknown where the first trial started, with `restart`."""
        tried = self._started(problem)
        for name in self._unknowns(problem) if self.restart else ():
            start = problem.get_buffer(f"start_{name}")
            if tried == 1:
                start.copy_(problem.fields[name]())
            elif tried:
                problem.fields[name].init_from(start)

    def _begin(self, problem: AnyProblem) -> None:
        """Set the weights for the next trial."""
        power = next_log2_weight(self._recorded(problem), self.first, self.least)
        self.reset(problem)
        problem.get_buffer(self._table)[self._started(problem), 0] = power
        self._weigh(problem, 2**power)

    def _weigh(self, problem: AnyProblem, factor: float) -> None:
        if self.unknown == SCENE:
            weigh_scene(problem, factor)
        else:
            weigh_unknown(problem, self.unknown, factor)

    @torch.no_grad()
    def _recorded(self, problem: AnyProblem) -> dict[float, float]:
        """Store the misfit of a finished trial on the held-out samples; returns log2 weight -> misfit, nats."""
        if not hasattr(problem, self._table):
            return {}
        table, last = problem.get_buffer(self._table), self._started(problem) - 1
        if last >= 0 and table[last, 1].isnan():
            table[last, 1] = held_out_misfit(problem)
        return {float(power): float(misfit) for power, misfit in table if misfit.isfinite()}

    def _started(self, problem: AnyProblem) -> int:
        """Number of trials that were begun."""
        found: Tensor = problem.get_buffer(self._table)[:, 0].isfinite().sum()
        return int(found)

    def _unknowns(self, problem: AnyProblem) -> tuple[str, ...]:
        return tuple(problem.scenes) if self.unknown == SCENE else (self.unknown,)

    @property
    def _table(self) -> str:
        return f"trials_{self.unknown}"


def fraction_for_weights(problem: AnyProblem) -> float:
    """Fraction of the samples to hold out: a tenth of one frame, spread over all."""
    frames = max(len(each.data) for each in problem.data_sets)
    return max(objective.HELD_OUT_FRACTION, HELD_OUT_SHARE / frames)


def held_out_misfit(problem: AnyProblem) -> Tensor:
    """Negative log-likelihood of the samples that are held out, nats."""
    values: Mapping[str, Any] = problem.values()
    found = [
        each.fidelity(
            each.predict({own: values[name] for own, name in problem.names_in(each).items()}),
            each.data,
            each.precision * each.held_out,
        )
        for each in problem.data_sets
    ]
    return torch.stack([each.double() for each in found]).sum()


def next_log2_weight(misfits: dict[float, float], first: float = COARSE_STEP, least: float = -math.inf) -> float:
    """Log2 of the next weight: beyond the best at an end of the range, else next to it, or again the best."""
    if not misfits:
        return first
    best = min(misfits, key=misfits.__getitem__)
    if best == min(misfits) and best > least:
        return max(best - COARSE_STEP, least)
    if best == max(misfits) and best < MAX_LOG2_WEIGHT:
        return min(best + COARSE_STEP, MAX_LOG2_WEIGHT)
    beside = (min(best + FINE_STEP, MAX_LOG2_WEIGHT), max(best - FINE_STEP, least))
    return next((power for power in beside if power not in misfits), best)


def best_log2_weight(misfits: dict[float, float]) -> float:
    """Minimum of the parabola through the best log2 weight and its neighbours; the best without these."""
    best = min(misfits, key=misfits.__getitem__)
    for step in (FINE_STEP, COARSE_STEP):
        low, middle, high = (misfits.get(best + sign * step) for sign in (-1, 0, 1))
        if low is not None and middle is not None and high is not None:
            curvature = low - 2 * middle + high
            return best + step * (low - high) / (2 * curvature) if curvature > 0 else best
    return best
