"""Weights of the scene's penalties by cross-validation: those under which held-out samples are predicted best.

How strong a prior is to be where the data leave the scene open is the scene's own matter: neither the noise nor the
number of frames says it. The search is a few short stages of a plan, each of which tries a weight. What it has found is
in a buffer of the problem, so that a resumed solve goes on with it.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from deepir.estimation.penalty_weights import weigh_scene
from deepir.problem import Problem
from deepir.schedule import Stage, Step

TRIALS = 7
ITERATIONS = 10  # of a trial, which begins where the one before it ended
#: Steps of the search, in powers of two. It begins at the first, from above: detail comes faster than it goes.
COARSE, FINE = 2.0, 1.0
#: Largest power: while the sensor is not quite known, a scene too smooth may predict best, and then it never will be.
MOST = 3.0


def start_trials(problem: Problem, *, afresh: bool = False) -> None:
    """Make room for the trials: each one's power of two of the natural weights, and its misfit.

    With `afresh` each begins with the scene of the first, not of the one before it: where much of the scene is open,
    one that has become rough does not become smooth again in so few iterations.
    """
    problem.register_buffer("trials", torch.full((TRIALS, 2), torch.nan, dtype=torch.float64))
    problem.register_buffer(
        "smooth", torch.zeros_like(problem.fields["scene"]().detach()) if afresh else None
    )


def cross_validation_stages(
    problem: Problem, *, first: float = COARSE, least: float = -math.inf, iterations: int = ITERATIONS
) -> list[Stage]:
    """The stages of the search, from the power `first` on down to `least`; none for weights that are given."""
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if not penalties or any(penalty.user_weight is not None for penalty in penalties):
        return []
    prepare = functools.partial(_try, first=first, least=least)
    return [Stage(f"weight {i + 1}", (Step(("scene",)),), iterations, prepare=prepare) for i in range(TRIALS)]


def weight_from_cross_validation(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights: `factor` times what the trials say; without any, times what is given or suits the noise."""
    tried = _conclude(problem)
    weigh_scene(problem, factor * (2 ** best_power(tried) if tried else 1.0))


def _try(problem: Problem, first: float, least: float) -> None:
    """Set the weights for the next trial."""
    tried = _conclude(problem)
    power = next_power(tried, first, least)
    reset_scene(problem)
    problem.get_buffer("trials")[_started(problem), 0] = power
    weigh_scene(problem, 2**power)


@torch.no_grad()
def reset_scene(problem: Problem) -> None:
    """Put the scene back to that of the first trial, if each is to begin with it."""
    scene, smooth = problem.fields["scene"], getattr(problem, "smooth", None)
    if smooth is None:
        return
    if _started(problem) == 1:
        smooth.copy_(scene())
    elif _started(problem):
        scene.init_from(smooth)


@torch.no_grad()
def _conclude(problem: Problem) -> dict[float, float]:
    """Note how a trial that has just ended predicts the held-out samples, nats; power -> misfit of all trials."""
    table, last = problem.get_buffer("trials"), _started(problem) - 1
    if last >= 0 and table[last, 1].isnan():
        precision = problem.precision * problem.held_out
        table[last, 1] = problem.fidelity(problem.predict(problem.values()), problem.data, precision)
    return {float(power): float(misfit) for power, misfit in table if misfit.isfinite()}


def _started(problem: Problem) -> int:
    found: Tensor = problem.get_buffer("trials")[:, 0].isfinite().sum()
    return int(found)


def next_power(tried: dict[float, float], first: float = COARSE, least: float = -math.inf) -> float:
    """Beyond the best where it lies at an end, else beside it; the best once more where nothing is left."""
    if not tried:
        return first
    best = min(tried, key=tried.__getitem__)
    if best == min(tried) and best > least:
        return max(best - COARSE, least)
    if best == max(tried) and best < MOST:
        return min(best + COARSE, MOST)
    beside = (min(best + FINE, MOST), max(best - FINE, least))
    return next((power for power in beside if power not in tried), best)


def best_power(tried: dict[float, float]) -> float:
    """The least of a parabola through the best and its neighbours at equal distances, if it has any."""
    best = min(tried, key=tried.__getitem__)
    for step in (FINE, COARSE):
        low, middle, high = (tried.get(best + way * step) for way in (-1, 0, 1))
        if low is not None and middle is not None and high is not None:
            bend = low - 2 * middle + high
            return best + step * (low - high) / (2 * bend) if bend > 0 else best
    return best
