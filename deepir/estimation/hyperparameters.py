"""Strengths from the data: how noisy the samples are, and how strong each part of gain and offset.

Everything is estimated between the stages of a solve, from what the stage before it found, and stays fixed during a
stage, so that the objective is one function.
"""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import Tensor

from deepir.arrays.median import median, robust_std
from deepir.arrays.noise_level import median_sigma
from deepir.arrays.subsample import masked_values, subsample
from deepir.effects.bad_pixels import (
    OUTLIER,
    pattern_outliers,
)
from deepir.effects.line_noise import estimate_line_noise
from deepir.effects.noise import update_noise
from deepir.effects.shading import estimate_low_order
from deepir.estimation.residuals import temporal_mean
from deepir.estimation.variance_components import likeliest
from deepir.fields.sensor_maps import Part
from deepir.fields.shading import Shading
from deepir.operators import Warp
from deepir.priors.penalties.spatially_weighted import SpatiallyWeighted
from deepir.problem import Problem

HELD_OUT = 0.02  # share of the samples that no fit sees
SLOW = 8  # degree of what is slow along the lines, of 64 and more
ROUNDS = 2  # of the parts' strengths at each update
#: A part is at most so many times as strong as the frames' average shows it: where the scene is not quite the same in
#: all frames (parallax), gain and offset would otherwise grow to explain it, and cancel each other.
MOST = 2.0


def hold_out(problem: Problem, seed: int, share: float = HELD_OUT) -> None:
    """Choose the samples that are held out, about so many of all."""
    generator = torch.Generator().manual_seed(seed)
    chosen = torch.rand(problem.data.shape, generator=generator) < share
    problem.held_out.copy_(chosen.to(problem.held_out.device))


def update_strengths(problem: Problem) -> None:
    """Noise and parts' strengths anew, in the gauge: what every round of a sensor's estimate begins with."""
    new = estimate_line_noise(problem)
    update_noise(problem)
    keep_gauge(problem)
    update_parts(problem, unasked={field.along for field in new})


def weigh_scene(problem: Problem, factor: float = 1.0) -> None:
    """Set the weights of the scene's penalties: `factor` times what is given, or what suits the noise.

    What else they need they learn from the scene as it is.
    """
    first = problem.operator.named()[0][1]
    with torch.no_grad():
        scene = problem.fields["scene"]()
    # Of frames that show the same scene the information adds up.
    precision = problem.precision.sum(0) if len(scene) == 1 else subsample(problem.precision)[0]
    average = median(masked_values(precision, precision > 0)) ** -0.5
    for penalty in problem.penalties["scene"].values() if "scene" in problem.penalties else ():
        noise = average * problem.operator.noise_gain
        if penalty.of_image and isinstance(first, Warp):  # it sees pixels, not the spline's coefficients
            noise /= first.noise_gain
        natural = penalty.natural(noise)
        if isinstance(penalty, SpatiallyWeighted) and not penalty.follows:  # by places, as the others do
            natural *= 2 ** float(problem.plain)
        natural *= 2 ** max(float(problem.plain) - penalty.clear, 0.0)
        penalty.weight.fill_(factor * (natural if penalty.given is None else penalty.given))
        with torch.no_grad():
            penalty.adapt(problem.shown("scene", scene, penalty), noise)


@torch.no_grad()
def start_parts(problem: Problem, rest: Tensor) -> None:
    """First strengths of gain and offset, split evenly, from the pattern: of the `rest` of the frames, see `left`.

    Pixels that are no part of it are left out. Gains are by the rms of the data: a dark frame with bright spots shows
    next to nothing of them in most places, and rows of 10 % stay where there are none. Their bounds are by the mean,
    unless the data are measured from their middle.
    """
    pattern = temporal_mean(rest, problem.precision.sign())  # as a float: torch is slow at the bool
    usable = problem.precision > 0
    data, counts = subsample(problem.data, usable)
    used = masked_values(data, counts)
    rms = float(used.square().mean().sqrt())
    level = rms if problem.reference else float(used.mean().abs())
    for slot, unit, most in (("gain", rms, level), ("offset", 1.0, 1.0)):
        for part in _all_parts(problem, slot):
            if not (part.given or isinstance(part, Shading)):
                found = robust_std(share(pattern, part)) / 2**0.5
                part.sigma.fill_(found / unit)
                part.most.fill_(MOST * found / most)
    known = usable.any(0, keepdim=True)
    # Of the median, too: one frame does not condemn a pixel.
    middle = rest.where(usable, torch.nan).nanmedian(0, keepdim=True).values.nan_to_num()
    problem.precision.mul_(~(pattern_outliers(pattern, known) & pattern_outliers(middle, known)))


@torch.no_grad()
def pattern_to_noise(problem: Problem) -> float:
    """How many times stronger than a sample's noise gain and offset are, by the strengths of their parts."""
    data, counts = subsample(problem.data, problem.precision > 0)
    power = {"gain": float(masked_values(data, counts).square().mean()), "offset": 1.0}
    variances = [
        power[slot] * float(part.sigma) ** 2
        for slot in power
        for part in _all_parts(problem, slot)
        if not isinstance(part, Shading)
    ]
    return sum(variances) ** 0.5 / median_sigma(problem.precision)


@torch.no_grad()
def down_weight_outliers(problem: Problem, rest: Tensor) -> None:
    """Let samples count less that neither the scene as it is nor a pattern explains.

    They are badly registered, or what they show moves by itself.
    """
    if problem.noise is not None:
        return
    most = problem.precision.amax()
    rest = rest - temporal_mean(rest, problem.precision / most)
    some, known = subsample(rest, problem.precision)
    if (usual := robust_std(masked_values(some, known > 0))) > 0:  # one frame leaves nothing
        for rest_k, precision_k in zip(rest, problem.precision, strict=True):
            doubt = rest_k.div_(OUTLIER * usual).square_().add_(1)
            torch.div(precision_k > 0, doubt, out=precision_k).mul_(most)


def share(pattern: Tensor, part: Part) -> Tensor:
    """The part's own share of a pattern: differences of neighbours, of the same variance.

    A part's values are independent, what the scene leaves in the pattern is mostly smooth.
    """
    own = pattern.mean(part.along, keepdim=True) if part.along else pattern
    for axis in {-2, -1} - set(part.along):
        own = own.diff(dim=axis) / 2**0.5
    return own


@torch.no_grad()
def keep_gauge(problem: Problem) -> None:
    """Carry what gain and offset have in common over to the scene: their parts are to be about one and zero.

    The data do not change with it, so nothing but the priors holds it, and it drifts.
    """
    values, closed = problem.values(), problem.closed_form()
    name = problem.operator.named()[-1][0]
    gain, offset = (problem.slots.get(f"{name}.{slot}", "") for slot in ("gain", "offset"))
    scene = values["scene"]
    if gain in closed:
        scene = scene * values[gain].mean()
    if offset in closed:
        scene = scene + values[offset].mean()
    problem.fields["scene"].init_from(scene)


@torch.no_grad()
def update_parts(problem: Problem, unasked: Collection[tuple[int, ...]] = ()) -> None:
    """Set the parts' strengths to the likeliest, the scene held; those of what is slow, whatever the scene is.

    Parts that are constant along the axes `unasked` have not been found yet with all that is known now.
    """
    closed = problem.closed_form()
    if not closed:
        return
    values = problem.values()
    flux = problem.flux(values)
    for _ in range(ROUNDS):
        for parts, information, means in problem.solved(values, closed, flux=flux).blocks():
            sigma, most = (
                torch.stack([getattr(part, name).double() if part else means.new_zeros(()) for part in parts])
                for name in ("sigma", "most")
            )
            free = [i for i, p in enumerate(parts) if p and not p.given and p.along not in unasked]
            quick = less_slow(means) if any(part and part.along for part in parts) else means
            for part, found in zip(parts, likeliest(information, quick, sigma, most, free), strict=True):
                if part and not part.given:
                    part.sigma.copy_(found)
    estimate_low_order(problem)


def less_slow(values: Tensor) -> Tensor:
    """Lines' values (2, K) less what is slow along them: that may as well be the scene's, and is no measure of them."""
    count = values.shape[1]
    along = torch.linspace(-1, 1, count, dtype=values.dtype, device=values.device)
    basis = torch.linalg.qr(torch.linalg.vander(along, N=min(SLOW, count // 8) + 1)).Q
    return values - values @ basis @ basis.T


def _all_parts(problem: Problem, slot: str) -> list[Part]:
    """Parts of what is bound to a slot of this name, whether they have a closed form or not."""
    unknowns = [name for each, name in problem.slots.items() if each.rpartition(".")[2] == slot]
    return [each for name in unknowns for each in problem.fields[name].modules() if isinstance(each, Part)]
