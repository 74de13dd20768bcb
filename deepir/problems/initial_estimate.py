"""The initial estimate: scene, fixed pattern and outliers by turns, from registered frames."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.arrays.statistics import median_sigma, robust_std
from deepir.arrays.windows import fill_nearest
from deepir.effects.bad_pixels import STATIC_PROBABILITY, static_pixels
from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.metrics import RegisteredAverage
from deepir.optim.low_order_model import polynomials
from deepir.problem import Problem

TURNS = 3  # of levels and gains of the frames, and of scene and outliers
MAX_PASSES = 20  # over scene and pattern, where the pattern is strong
PATTERN_TOLERANCE = 1.0  # standard deviations of the noise by which the pattern of the last pass may change
MIN_FRAMES_SEEN = 0.1  # frames that must show a pixel of the scene


def initial_estimate(problem: Problem, effects: Sequence[Effect]) -> None:
    """Start the scene at the registered average, and let effects mask samples and set first hyperparameters.

    1. The effects prepare: noise, masks that are known.
    2. The scene is the registered average of the frames; samples are rejected by its residual.
    3. The frames are brought to one level and gain, and averaged again.
    4. The fixed pattern is subtracted from the average: fully where it is stronger than the scene.
    5. Scene and outliers by turns: an object seen in two of five frames shifts the mean, and with it its own residual.
    """
    for effect in effects:
        effect.prepare(problem)
    noise = median_sigma(problem.precision)
    usable = problem.precision > 0
    static = static_pixels(problem.data, usable, noise)
    still = static_pixels(problem.data, usable, noise, STATIC_PROBABILITY)

    def reject(step: int, residual: Tensor) -> None:
        estimate = InitialEstimate(problem, noise, static, still, step, residual)
        for effect in effects:
            effect.reject(estimate)

    start_scene(problem)
    reject(0, fixed_pattern_residual(problem))
    start_scene(problem)
    for _ in range(TURNS):
        changed = [effect.equalise(problem) for effect in effects]
        if not any(changed):
            break
        start_scene(problem)
    residual = fixed_pattern_residual(problem)
    fixed = len(problem.data) > 1 and bool(problem.closed_form())
    strong = fixed and pattern_is_strong(problem, residual)
    pattern = torch.zeros_like(residual[:1])
    if strong:
        residual = subtract_fixed_pattern(problem, residual, pattern, noise, strong=True)
    for step in range(1, TURNS + 2):
        # What saturates moves with the scene, and is no pattern.
        if step > 1 and (strong or (fixed and problem.saturation is None)):
            residual = subtract_fixed_pattern(problem, residual, pattern, noise, strong=strong)
        elif step > 1:
            start_scene(problem)
            residual = fixed_pattern_residual(problem)
        reject(step, residual)
    for effect in effects:
        effect.initialise(problem)


@torch.no_grad()
def pattern_is_strong(problem: Problem, rest: Tensor) -> bool:
    """Whether the fixed pattern is stronger than all that is in the average of the frames."""
    scene, weight = problem.backproject(problem.values())
    pattern = temporal_mean(rest, problem.precision.sign())
    # By the standard deviation: before a black sky the bulk has next to none.
    return robust_std(pattern) > float(scene[weight > MIN_FRAMES_SEEN * weight.max()].std())


@torch.no_grad()
def subtract_fixed_pattern(problem: Problem, rest: Tensor, taken: Tensor, noise: float, *, strong: bool) -> Tensor:
    """Subtract the fixed pattern from the scene's start, pattern and scene by turns.

    A pattern many times stronger than the scene dominates the average, and no solve recovers from that. Of weaker ones
    one turn removes most; their low-order part stays in the scene, unless shading is found. A `strong` one is iterated
    until it converges, low-order part included.

    Args:
        problem: Its scene is started anew.
        rest: Residual of the frames, (N, 1, h, w), fixed pattern included; the new one is returned.
        taken: The pattern subtracted before, (1, 1, h, w); updated.
        noise: Standard deviation of a sample's noise.
        strong: Whether the pattern is stronger than the scene.
    """
    average = RegisteredAverage(problem, problem.values())
    weight = problem.precision / problem.precision.amax()
    for _ in range(MAX_PASSES if strong else 1):
        pattern = temporal_mean(rest, weight)
        if not strong:
            slow = polynomials(*pattern.shape[-2:], pattern.device)
            pattern -= slow.project(pattern.double()).to(pattern)
        change = robust_std(pattern - taken)
        taken.copy_(pattern)
        start_scene(problem, average, pattern)
        rest = fixed_pattern_residual(problem, average)
        if change < PATTERN_TOLERANCE * noise:
            break
    return rest


@torch.no_grad()
def start_scene(problem: Problem, average: RegisteredAverage | None = None, pattern: Tensor | float = 0.0) -> None:
    """Start the scene at the registered average of the frames; unobserved pixels take their nearest neighbour.

    The pattern is subtracted from every frame. The average is computed if it is not known.
    """
    average = average or RegisteredAverage(problem, problem.values())
    mean = average((problem.data - average.at_zero).sub_(pattern))
    frames = len(problem.data) / len(mean)  # that show a scene
    known = average.weight > MIN_FRAMES_SEEN * average.weight.max() / frames
    problem.fields["scene"].init_from(fill_nearest(mean, known))
