"""Weights of the scene's penalties; they are constant during a stage, so that its objective is one function."""

from __future__ import annotations

import torch

from deepir.arrays.statistics import masked_values, median, subsample
from deepir.joint_problem import AnyProblem
from deepir.priors.penalties.base import Penalty
from deepir.priors.penalties.spatially_weighted import SpatiallyWeighted
from deepir.problem import Problem


def weigh_scene(problem: AnyProblem, factor: float = 1.0) -> None:
    """Set the weights of the scenes' penalties and adapt their state to the present scenes.

    Args:
        problem: Its penalties are changed.
        factor: Factor on the weight of the configuration, or on the default weight for the noise.
    """
    for name, shown_by in problem.scenes.items():
        first, averages = shown_by[0], [_average_noise(each) for each in shown_by]
        with torch.no_grad():
            scene = problem.fields[name]()
        for penalty in first.penalties["scene"].values() if "scene" in first.penalties else ():
            each = [_scene_noise(*one, penalty) for one in zip(shown_by, averages, strict=True)]
            # Of data sets that show the same scene the information adds up.
            noise = each[0] if len(each) == 1 else sum(one**-2 for one in each) ** -0.5
            default = penalty.default_weight(noise)
            if isinstance(penalty, SpatiallyWeighted) and not penalty.adapts:  # by places, as the others do
                default *= 2 ** float(first.smoothness_exponent)
            default *= 2 ** max(float(first.smoothness_exponent) - penalty.smooth_scene_threshold, 0.0)
            penalty.weight.fill_(factor * (default if penalty.user_weight is None else penalty.user_weight))
            with torch.no_grad():
                penalty.adapt(first.shown("scene", scene, penalty), noise)


def _average_noise(problem: Problem) -> float:
    """Standard deviation of the noise of the frames' average."""
    # Of frames that show the same scene the information adds up.
    shared = problem.fields["scene"].shape[0] == 1
    precision = problem.precision.sum(0) if shared else subsample(problem.precision)[0]
    return median(masked_values(precision, precision > 0)) ** -0.5


def _scene_noise(problem: Problem, average: float, penalty: Penalty) -> float:
    """The same of what a penalty sees of the scene."""
    first, noise = problem.operator.named()[0][1], average * problem.operator.noise_gain
    if penalty.acts_on_pixels and first.moves:  # it sees pixels, not the spline's coefficients
        noise /= first.noise_gain
    return noise
