"""Weights of the scene's penalties; they are constant during a stage, so that its objective is one function."""

from __future__ import annotations

import torch

from deepir.arrays.statistics import masked_values, median, subsample
from deepir.priors.penalties.spatially_weighted import SpatiallyWeighted
from deepir.problem import Problem


def weigh_scene(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights of the scene's penalties and adapt their state to the present scene.

    Args:
        problem: Its penalties are changed.
        factor: Factor on the weight of the configuration, or on the default weight for the noise.
    """
    first = problem.operator.named()[0][1]
    with torch.no_grad():
        scene = problem.fields["scene"]()
    # Of frames that show the same scene the information adds up.
    precision = problem.precision.sum(0) if len(scene) == 1 else subsample(problem.precision)[0]
    average = median(masked_values(precision, precision > 0)) ** -0.5
    for penalty in problem.penalties["scene"].values() if "scene" in problem.penalties else ():
        noise = average * problem.operator.noise_gain
        if penalty.acts_on_pixels and first.moves:  # it sees pixels, not the spline's coefficients
            noise /= first.noise_gain
        default = penalty.default_weight(noise)
        if isinstance(penalty, SpatiallyWeighted) and not penalty.adapts:  # by places, as the others do
            default *= 2 ** float(problem.smoothness_exponent)
        default *= 2 ** max(float(problem.smoothness_exponent) - penalty.smooth_scene_threshold, 0.0)
        penalty.weight.fill_(factor * (default if penalty.user_weight is None else penalty.user_weight))
        with torch.no_grad():
            penalty.adapt(problem.shown("scene", scene, penalty), noise)
