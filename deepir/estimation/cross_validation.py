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

#: Number of weights that are misfits.
N_TRIALS = 7
#: Iterations of a trial, which starts from the scene of the one before.
TRIAL_ITERATIONS = 10
#: First step of the search in log2 of the weight; also where it starts, from above: detail appears faster than it goes.
COARSE_STEP = 2.0
#: Second step of the search, in log2 of the weight.
FINE_STEP = 1.0
#: Largest log2 of the weight: with an inaccurate sensor an oversmoothed scene may predict best and would remain.
MAX_LOG2_WEIGHT = 3.0


def start_trials(problem: Problem, *, restart: bool = False) -> None:
    """Make room for the trials: each one's power of two of the natural weights, and its misfit.

    With `restart` each begins with the scene of the first, not of the one before it: where much of the scene is open,
    one that has become rough does not become smooth again in so few iterations.
    """
    problem.register_buffer("trials", torch.full((N_TRIALS, 2), torch.nan, dtype=torch.float64))
    problem.register_buffer(
        "smooth", torch.zeros_like(problem.fields["scene"]().detach()) if restart else None
    )


def cross_validation_stages(
    problem: Problem,
    *,
    first: float = COARSE_STEP,
    least: float = -math.inf,
    iterations: int = TRIAL_ITERATIONS,
) -> list[Stage]:
    """The stages of the search, from the power `first` on down to `least`; none for weights that are given."""
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if not penalties or any(penalty.user_weight is not None for penalty in penalties):
        return []
    prepare = functools.partial(_begin_trial, first=first, least=least)
    return [
        Stage(f"weight {i + 1}", (Step(("scene",)),), iterations, prepare=prepare) for i in range(N_TRIALS)
    ]


def weight_from_cross_validation(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights: `factor` times what the trials say; without any, times what is given or suits the noise."""
    misfits = _record_trial(problem)
    weigh_scene(problem, factor * (2 ** best_log2_weight(misfits) if misfits else 1.0))


def _begin_trial(problem: Problem, first: float, least: float) -> None:
    """Set the weights for the next trial."""
    misfits = _record_trial(problem)
    power = next_log2_weight(misfits, first, least)
    reset_scene(problem)
    problem.get_buffer("trials")[_n_started(problem), 0] = power
    weigh_scene(problem, 2**power)


@torch.no_grad()
def reset_scene(problem: Problem) -> None:
    """Put the scene back to that of the first trial, if each is to begin with it."""
    scene, smooth = problem.fields["scene"], getattr(problem, "smooth", None)
    if smooth is None:
        return
    if _n_started(problem) == 1:
        smooth.copy_(scene())
    elif _n_started(problem):
        scene.init_from(smooth)


@torch.no_grad()
def _record_trial(problem: Problem) -> dict[float, float]:
    """Note how a trial that has just ended predicts the held-out samples, nats; power -> misfit of all trials."""
    table, last = problem.get_buffer("trials"), _n_started(problem) - 1
    if last >= 0 and table[last, 1].isnan():
        precision = problem.precision * problem.held_out
        table[last, 1] = problem.fidelity(problem.predict(problem.values()), problem.data, precision)
    return {float(power): float(misfit) for power, misfit in table if misfit.isfinite()}


def _n_started(problem: Problem) -> int:
    found: Tensor = problem.get_buffer("trials")[:, 0].isfinite().sum()
    return int(found)


def next_log2_weight(
    misfits: dict[float, float], first: float = COARSE_STEP, least: float = -math.inf
) -> float:
    """Beyond the best where it lies at an end, else beside it; the best once more where nothing is left."""
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
    """The least of a parabola through the best and its neighbours at equal distances, if it has any."""
    best = min(misfits, key=misfits.__getitem__)
    for step in (FINE_STEP, COARSE_STEP):
        low, middle, high = (misfits.get(best + sign * step) for sign in (-1, 0, 1))
        if low is not None and middle is not None and high is not None:
            curvature = low - 2 * middle + high
            return best + step * (low - high) / (2 * curvature) if curvature > 0 else best
    return best
