"""The weight of the prior of the scene: where it holds, whether it is too strong, and how sure the scene is."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from deepir.arrays.statistics import masked_values, median, subsample
from deepir.arrays.windows import box_sum, squared_gradient
from deepir.joint_problem import AnyProblem
from deepir.optim.fourier_hessian import spline_response, variance_spectrum
from deepir.optim.preconditioner import scene_information
from deepir.priors.penalties.base import Penalty, SpatiallyWeighted
from deepir.problem import Problem

TEXTURE_WINDOW = 7  # side of the windows over which gradients are averaged, px
INFORMATION_WINDOW = 5  # side of the windows over which the information of samples is averaged, px
#: Numerator a of the weight `2 ** ((a / r)² - b)` at gradients of r noise standard deviations; fitted on the truth of
#: the bursts in notes/estimates-scene.md, as the next two are.
LOCAL_SMOOTHNESS_SCALE = 2.75
LOCAL_EXPONENT_OFFSET = 0.3  # offset b of that exponent
MAX_LOCAL_EXPONENT = 1.5  # largest exponent, unless the whole scene is smoother
#: Numerator a of the factor `2 ** (a / r)²` on the weight for a scene of mean gradient r, noise standard deviations.
GLOBAL_SMOOTHNESS_SCALE = 3.1
NOISE_GRADIENT = 1.77  # mean gradient of pure noise, noise standard deviations: the square root of pi
GRADIENT_OFFSET = 0.1  # offset of a gradient before its logarithm is averaged, noise standard deviations
#: Range of the information of samples at a pixel, relative to a typical one, that the weights follow.
WEIGHT_INFORMATION_RANGE = (0.5, 1.0)
#: Excess of the squared residual over pure noise from which a scene is oversmoothed, noise variances per pixel.
MAX_EXCESS_MISFIT = 0.1
#: Fraction of the scene that must be flat for the test: beside much texture the residual varies by more.
MIN_FLAT_FRACTION = 0.4
N_PROBES = 4  # number of probes of the information on an unknown
PROBE_STEP = 1e-2  # step of a probe, relative to the largest value, or to 1 below it
WEIGHT_REDUCTION = 2**-0.5  # factor on the weight of a penalty that oversmooths


@torch.no_grad()
def adapt_weight_map(problem: Problem, cost: float = 0.0) -> None:
    """Set the weight maps of adaptive penalties from the texture and the information at each pixel.

    Texture is the geometric mean over windows of the gradients of a scene found under a weak prior, so that single
    edges in a smooth region count little. Other spatially weighted penalties get one factor for the whole scene. The
    noise of the scene exceeds that of the samples by the pattern cost, dB.
    """
    if problem.fields["scene"].shape[0] > 1:
        return
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    adaptive = [each for each in penalties if isinstance(each, SpatiallyWeighted) and each.is_adaptive]
    information, typical = _information(problem)
    noise_factor = 10 ** (cost / 20)
    gradient = squared_gradient(problem.operator.to_pixels(problem.fields["scene"]()))
    mean = float(gradient[information > WEIGHT_INFORMATION_RANGE[0] * typical].sqrt().mean()) * typical**0.5
    exponent = smoothness_exponent(mean)
    weight = weight_from_gradients((gradient * information).sqrt_(), exponent, noise_factor)
    weight_map = noise_factor * weight * (information / typical).sqrt_()
    problem.smoothness_exponent.fill_(exponent)
    for penalty in adaptive:
        if penalty.adapts:
            penalty.weight_map.copy_(weight_map[0, 0])
        else:
            penalty.weight.mul_(2**exponent)


def smoothness_exponent(gradient: float) -> float:
    """log2 of the extra penalty weight that a scene of this mean gradient allows, noise standard deviations per px."""
    return (GLOBAL_SMOOTHNESS_SCALE / max(gradient, NOISE_GRADIENT)) ** 2


def weight_from_gradients(gradient: Tensor, exponent: float, noise_factor: float = 1.0) -> Tensor:
    """Weight map of a penalty, (1, 1, H, W), relative to its default weight.

    Args:
        gradient: Of the scene, same shape, noise standard deviations per px.
        exponent: Of `smoothness_exponent` for the whole scene.
        noise_factor: Noise of the scene relative to that of its samples.
    """
    texture = _mean((gradient + GRADIENT_OFFSET).log_(), TEXTURE_WINDOW).exp_()
    exponents = (noise_factor * LOCAL_SMOOTHNESS_SCALE / texture) ** 2 - LOCAL_EXPONENT_OFFSET
    return exponents.clamp_(max=max(MAX_LOCAL_EXPONENT, exponent)).exp2_()


def _information(problem: Problem) -> tuple[Tensor, float]:
    """Inverse noise variance of each pixel of the scene, (1, 1, H, W), and of a typical one."""
    summed = problem.precision.sum(0)
    typical = float(summed[summed > 0].median())
    low, high = (share * typical for share in WEIGHT_INFORMATION_RANGE)
    return _mean(scene_information(problem), INFORMATION_WINDOW).clamp_(low, high), typical


def _mean(image: Tensor, window: int) -> Tensor:
    """Mean over each window of an image (1, 1, H, W), at the border over its inner part."""
    return box_sum(image, window) / box_sum(torch.ones_like(image), window)


def weigh_scene(problem: AnyProblem, factor: float = 1.0) -> None:
    """Set the weights of the scenes' penalties and adapt their state to the present scenes.

    To `factor` times the weight of the configuration, or the default weight for the noise.
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


def weigh_unknown(problem: AnyProblem, name: str, factor: float = 1.0) -> None:
    """Set the weights of the penalties of an unknown that is no scene, see `weigh_scene`."""
    noise = math.nan
    for penalty in penalties_of(problem, name):
        if penalty.user_weight is None and math.isnan(noise):
            noise = unknown_noise(problem, name)
        weight = penalty.default_weight(noise) if penalty.user_weight is None else penalty.user_weight
        penalty.weight.fill_(factor * weight)


def penalties_of(problem: AnyProblem, name: str) -> tuple[Penalty, ...]:
    """The penalties of an unknown; () without any."""
    return tuple(problem.penalties[name].values()) if name in problem.penalties else ()


@torch.no_grad()
def unknown_noise(problem: AnyProblem, name: str) -> float:
    """Standard deviation of the noise of an unknown of which nothing but the data is known.

    It is that of a typical entry, `diag(J' W J)^-1/2`, from the derivative J of the prediction at the present values;
    the diagonal is probed with random signs (Bekas, Kokiopoulou, Saad 2007). In the units of the unknown; inf if the
    data do not depend on it.
    """
    values = problem.values()
    value = values[name]
    generator = torch.Generator().manual_seed(0)
    information = torch.zeros_like(value, dtype=torch.float64)
    step = PROBE_STEP * max(float(value.abs().max()), 1.0)
    for _ in range(N_PROBES):
        signs = torch.randint(0, 2, value.shape, generator=generator).to(value) * 2 - 1
        for each in problem.data_sets:
            own = {mine: values[known] for mine, known in problem.names_in(each).items()}
            mine = next((mine for mine, known in problem.names_in(each).items() if known == name), None)
            if mine is None:
                continue
            change = (each.predict(own | {mine: value + step * signs}) - each.predict(own)) / step
            with torch.enable_grad():
                moved = value.detach().requires_grad_()
                predicted = each.predict(own | {mine: moved})
                (back,) = torch.autograd.grad((predicted * (each.precision * change)).sum(), moved)
            information += signs * back / N_PROBES
    seen = information[information > 0]
    return float(seen.median()) ** -0.5 if len(seen) else math.inf


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


@torch.no_grad()
def store_reference_misfit(problem: Problem) -> None:
    """Store the squared residual of the present estimate, obtained with a weak prior, as the reference."""
    problem.reference_misfit.copy_(_squared_residual(problem))


def is_oversmoothed(problem: AnyProblem) -> bool:
    """Whether the prior has removed more than noise from a scene; False if the test does not apply."""
    return any(map(_is_oversmoothed, problem.data_sets))


def _is_oversmoothed(problem: Problem) -> bool:
    flat = _flat_fraction(problem)
    if not flat > MIN_FLAT_FRACTION:
        return False
    taken = float(_squared_residual(problem) - problem.reference_misfit) / int(problem.alive().sum())
    return taken - flat > MAX_EXCESS_MISFIT


def reduce_weight(problem: AnyProblem) -> None:
    """Multiply the weights of the penalties by `WEIGHT_REDUCTION` where a scene is oversmoothed."""
    for each in filter(_is_oversmoothed, problem.data_sets):
        for penalty in each.penalties["scene"].values():
            penalty.weight.mul_(WEIGHT_REDUCTION)


@torch.no_grad()
def _squared_residual(problem: Problem) -> torch.Tensor:
    return 2 * problem.misfit(problem.values(), (), problem.precision)


@torch.no_grad()
def _flat_fraction(problem: Problem) -> float:
    """Fraction of the scene that its penalty flattens; NaN unless there is one penalty with an automatic weight."""
    penalties = list(problem.penalties["scene"].values()) if "scene" in problem.penalties else []
    if len(penalties) != 1 or penalties[0].user_weight is not None:
        return math.nan
    scene = problem.values()["scene"]
    return penalties[0].fraction_shrunk_to_zero(problem.shown("scene", scene, penalties[0]))


Maps = dict[str, np.ndarray]


@torch.no_grad()
def pattern_cost_db(problem: Problem, penalty_factor: float = 1.0) -> float:
    """Pattern cost, dB: ratio of the scene's mean squared error with unknown to that with known gain and offset.

    Both errors are those of the model of `deepir.optim.preconditioner`, at the current values, with that factor on the
    scene's penalties while the pattern was estimated. For white noise and any pattern the cost is
    `10 log10 (n / (n - 1))` for n frames. NaN without a Fourier model.
    """
    found = [variance_spectrum(problem, each, penalty_factor) for each in (problem.closed_form(), ())]
    if any(each is None for each in found):
        return math.nan
    response = spline_response(problem)
    response[0, 0] = 0  # no burst shows the level
    free, known = (float((response * each).sum()) for each in found if each is not None)
    return 10 * math.log10(free / known)


@torch.no_grad()
def uncertainty(problem: Problem, cost: float) -> Maps:
    """Standard deviations of the current estimates, in their units: `scene` (S, 1, H, W), `gain` and `offset` (h, w).

    Scene: noise of the samples, back-projected, times the pattern cost, dB. Gain and offset: posterior given the
    scene, hence slightly too small; left out without a closed form, or if each frame has a scene of its own.
    """
    values = problem.values()
    slots = {slot: values[name] for slot, name in problem.slots.items()}
    seen = problem.operator.adjoint(problem.precision, tuple(values["scene"].shape), **slots)
    found = {"scene": (seen.clamp(min=float(seen.max()) * 1e-6).rsqrt() * 10 ** (cost / 20))}
    closed = problem.closed_form()
    if closed and len(seen) == 1:
        solved = problem.solved(values, closed, precision=problem.precision)
        for name, variances in zip(problem.gain_and_offset(), solved.posterior_variances(), strict=True):
            parts = problem.fields[name].parts()
            total = sum(part.map_variance(each) for part, each in zip(parts, variances, strict=True))
            if isinstance(total, Tensor):
                found[name] = total.expand(problem.fields[name].shape)[0, 0].sqrt()
        if problem.reference and len(closed) == 2:
            gain, offset = closed
            found[offset] = _from_zero(problem, values, found[gain], found[offset])
    return {name: each.cpu().numpy().astype(np.float32) for name, each in found.items()}


def _from_zero(problem: Problem, values: dict[str, Tensor], gain: Tensor, offset: Tensor) -> Tensor:
    """Standard deviation (h, w) of the offset `o - (g - 1) L` relative to zero instead of the reference level L."""
    parts, (aa, ab, bb), _ = next(problem.solved(values, problem.closed_form()).information_blocks())
    u, v = (float(part.sigma) ** 2 if part else 0.0 for part in parts)
    covariance = -ab * u * v / (1 + u * aa + v * bb + u * v * (aa * bb - ab * ab))
    level = float(problem.reference)
    variance = offset.square() + level**2 * gain.square() - 2 * level * covariance.reshape(offset.shape).to(offset)
    return variance.clamp_min(0).sqrt()
