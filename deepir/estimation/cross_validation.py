"""Weights of the scene's penalties by cross-validation on held-out samples.

Neither the noise nor the number of frames determines how strong a prior should be where the data leave the scene open.
The search consists of short stages, each with one weight; its table is a buffer of the problem, so that a resumed solve
continues it.
"""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor

from deepir.estimation.prior_weight import weigh_scene
from deepir.problem import Problem
from deepir.schedule import Stage, Step

#: Number of weights that are tried.
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
    """Register the buffers of the search: log2 of each weight relative to the default, and its misfit.

    Args:
        problem: Gets the buffers.
        restart: Whether each trial starts from the scene of the first: where much of the scene is undetermined, a rough
            scene does not become smooth again within one trial.
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
    """Stages of the search; none if a weight is fixed.

    Args:
        problem: Its scene has the penalties.
        first: Log2 of the first weight, relative to the default.
        least: Smallest log2 of a weight.
        iterations: Most iterations of a trial.
    """
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if not penalties or any(penalty.user_weight is not None for penalty in penalties):
        return []
    prepare = functools.partial(_begin_trial, first=first, least=least)
    return [
        Stage(f"weight {i + 1}", (Step(("scene",)),), iterations, prepare=prepare) for i in range(N_TRIALS)
    ]


def weight_from_cross_validation(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights to `factor` times the best of the trials; without trials, times the usual weight."""
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
    """Reset the scene to that of the first trial, if the search was started with `restart`."""
    scene, smooth = problem.fields["scene"], getattr(problem, "smooth", None)
    if smooth is None:
        return
    if _n_started(problem) == 1:
        smooth.copy_(scene())
    elif _n_started(problem):
        scene.init_from(smooth)


@torch.no_grad()
def _record_trial(problem: Problem) -> dict[float, float]:
    """Store the misfit of a finished trial on the held-out samples; returns log2 weight -> misfit, nats."""
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
