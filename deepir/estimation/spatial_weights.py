"""Spatially adaptive weights of the scene's penalties: stronger in smooth regions, weaker in texture."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.differences import squared_gradient
from deepir.arrays.windows import box_sum
from deepir.operators import Sensor
from deepir.priors.penalties.spatially_weighted import SpatiallyWeighted
from deepir.problem import Problem

#: Side of the windows over which gradients are averaged, px.
TEXTURE_WINDOW = 7
#: Side of the windows over which the information of samples is averaged, px.
INFORMATION_WINDOW = 5
#: Numerator a of the weight `2 ** ((a / r)² - b)` at gradients of r noise standard deviations; fitted on the truth of
#: the bursts in notes/estimates-scene.md, as the next two are.
LOCAL_SMOOTHNESS_SCALE = 2.75
#: Offset b of that exponent.
LOCAL_EXPONENT_OFFSET = 0.3
#: Largest exponent, unless the whole scene is smoother.
MAX_LOCAL_EXPONENT = 1.5
#: Numerator a of the factor `2 ** (a / r)²` on the weight for a scene of mean gradient r, noise standard deviations.
GLOBAL_SMOOTHNESS_SCALE = 3.1
#: Mean gradient of pure noise, noise standard deviations: the square root of pi.
NOISE_GRADIENT = 1.77
#: Offset of a gradient before its logarithm is averaged, noise standard deviations.
GRADIENT_OFFSET = 0.1
#: Range of the information of samples at a pixel, relative to a typical one, that the weights follow.
WEIGHT_INFORMATION_RANGE = (0.5, 1.0)


@torch.no_grad()
def adapt_weight_map(problem: Problem, cost: float = 0.0) -> None:
    """Set the weight maps of adaptive penalties from the texture and the information at each pixel.

    Texture is the geometric mean over windows of the gradients of a scene found under a weak prior, so that single
    edges in a smooth region count little. Other spatially weighted penalties get one factor for the whole scene.

    Args:
        problem: Its scene is the one under a weak prior; the weights of its penalties are changed.
        cost: Pattern cost, dB: the noise of the scene exceeds that of the samples by this.
    """
    if problem.fields["scene"].shape[0] > 1:
        return
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    adaptive = [each for each in penalties if isinstance(each, SpatiallyWeighted) and each.is_adaptive]
    information, typical = _information(problem)
    noise_factor = 10 ** (cost / 20)
    image = problem.operator.to_pixels(problem.fields["scene"]())
    gradient = squared_gradient(image)
    exponent = smoothness_exponent(
        float(gradient[information > WEIGHT_INFORMATION_RANGE[0] * typical].sqrt().mean()) * typical**0.5
    )
    weight_map = (
        noise_factor
        * weight_from_gradients((gradient * information).sqrt_(), exponent, noise_factor)
        * (information / typical).sqrt_()
    )
    problem.smoothness_exponent.fill_(exponent)
    for penalty in adaptive:
        if penalty.adapts:
            penalty.weight_map.copy_(weight_map[0, 0])
        else:
            penalty.weight.mul_(2**exponent)


def smoothness_exponent(gradient: float) -> float:
    """log2 of the extra penalty weight that a smooth scene allows.

    Args:
        gradient: Mean gradient of the scene, noise standard deviations per px.
    """
    return (GLOBAL_SMOOTHNESS_SCALE / max(gradient, NOISE_GRADIENT)) ** 2


def weight_from_gradients(gradient: Tensor, exponent: float, noise_factor: float = 1.0) -> Tensor:
    """Weight map of a penalty, relative to its default weight.

    Args:
        gradient: Of the scene, (1, 1, H, W), noise standard deviations per px; changed in place.
        exponent: Of `smoothness_exponent` for the whole scene.
        noise_factor: Noise of the scene relative to that of its samples.

    Returns:
        (1, 1, H, W).
    """
    texture = _mean((gradient + GRADIENT_OFFSET).log_(), TEXTURE_WINDOW).exp_()
    return (
        ((noise_factor * LOCAL_SMOOTHNESS_SCALE / texture) ** 2 - LOCAL_EXPONENT_OFFSET)
        .clamp_(max=max(MAX_LOCAL_EXPONENT, exponent))
        .exp2_()
    )


def _information(problem: Problem) -> tuple[Tensor, float]:
    """Inverse noise variance of each pixel of the scene, (1, 1, H, W), and of a typical one."""
    slots = {slot: problem.fields[name]() for slot, name in problem.slots.items()}
    summed = problem.precision.sum(0)
    typical = float(summed[summed > 0].median())
    weighed = problem.precision * slots.get(problem.slot(Sensor, "gain"), 1.0)  # once more by the adjoint
    information = problem.operator.adjoint(weighed, (1, 1, *problem.fields["scene"].shape[-2:]), **slots)
    low, high = WEIGHT_INFORMATION_RANGE
    return _mean(information, INFORMATION_WINDOW).clamp_(low * typical, high * typical), typical


def _mean(image: Tensor, window: int) -> Tensor:
    """Mean over each window of an image (1, 1, H, W), at the border over its inner part."""
    return box_sum(image, window) / box_sum(torch.ones_like(image), window)
