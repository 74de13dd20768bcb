"""How strong the scene's penalties are from place to place: where it is plain, rich, dark."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.differences import squared_gradient
from deepir.arrays.windows import box_sum
from deepir.operators import Sensor
from deepir.priors.penalties.spatially_weighted import SpatiallyWeighted
from deepir.problem import Problem

WINDOW = 7  # px: side of the windows whose gradients are one texture
SURE = 5  # px: side of the windows whose samples are taken together
#: Gradients of `r` standard deviations of the noise bear `2 ** ((PLAIN / r)² - RICH)` times the natural weight,
#: `2 ** MOST` at most: the best on the truth of the bursts in docs/estimates-scene.md.
PLAIN, RICH, MOST = 2.75, 0.3, 1.5
#: A scene whose mean gradient is `r` may be held `2 ** (PLAINER / r)²` times as strongly; noise alone has `NOISE`, √π.
PLAINER, NOISE = 3.1, 1.77
LEAST = 0.1  # standard deviations: gradients are not told from this
#: What samples say of a place, to what they say of a usual one, is taken into account between these.
UNEVEN = (0.5, 1.0)


@torch.no_grad()
def adapt_weight_map(problem: Problem, cost: float = 0.0) -> None:
    """Let penalties that may vary be weaker where the scene is rich or its samples unsure, stronger where it is plain.

    Texture is the geometric mean of gradients, over windows, of the scene that was found under next to no prior: edges
    in a plain place are few, and do not count for much. It costs `cost` dB that the pattern is not known: the scene's
    noise is as much above that of its samples, which weigh so much more than they tell.
    """
    if problem.fields["scene"].shape[0] > 1:
        return
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    free = [each for each in penalties if isinstance(each, SpatiallyWeighted) and each.is_adaptive]
    sure, usual = _information(problem)
    above = 10 ** (cost / 20)
    image = problem.operator.to_pixels(problem.fields["scene"]())
    gradient = squared_gradient(image)
    plain = smoothness_exponent(float(gradient[sure > UNEVEN[0] * usual].sqrt().mean()) * usual**0.5)
    share = above * weight_from_gradients((gradient * sure).sqrt_(), plain, above) * (sure / usual).sqrt_()
    problem.plain.fill_(plain)
    for penalty in free:
        if penalty.adapts:
            penalty.weight_map.copy_(share[0, 0])
        else:
            penalty.weight.mul_(2**plain)


def smoothness_exponent(gradient: float) -> float:
    """The power of two that a scene may be held by more whose mean gradient, in standard deviations, is given."""
    return (PLAINER / max(gradient, NOISE)) ** 2


def weight_from_gradients(gradient: Tensor, plain: float, above: float = 1.0) -> Tensor:
    """How strongly places (1, 1, H, W) are held that have these gradients, in standard deviations of the noise."""
    texture = _mean((gradient + LEAST).log_(), WINDOW).exp_()
    return ((above * PLAIN / texture) ** 2 - RICH).clamp_(max=max(MOST, plain)).exp2_()


def _information(problem: Problem) -> tuple[Tensor, float]:
    """One over the square of the noise of each pixel of the scene, (1, 1, H, W), and of a usual one."""
    slots = {slot: problem.fields[name]() for slot, name in problem.slots.items()}
    summed = problem.precision.sum(0)
    usual = float(summed[summed > 0].median())
    weighed = problem.precision * slots.get(problem.slot(Sensor, "gain"), 1.0)  # once more by the adjoint
    told = problem.operator.adjoint(weighed, (1, 1, *problem.fields["scene"].shape[-2:]), **slots)
    low, high = UNEVEN
    return _mean(told, SURE).clamp_(low * usual, high * usual), usual


def _mean(image: Tensor, window: int) -> Tensor:
    """The mean over each window of an image (1, 1, H, W); at the edge of what is inside."""
    return box_sum(image, window) / box_sum(torch.ones_like(image), window)
