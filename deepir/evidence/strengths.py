"""Strengths from the data: how noisy the samples are, and how strong each part of gain and offset.

Everything is estimated between the stages of a solve, from what the stage before it found, and stays fixed during a
stage, so that the objective is one function.
"""

from __future__ import annotations

from collections.abc import Collection

import torch
from torch import Tensor

from deepir.average import Average
from deepir.evidence.parts import likeliest
from deepir.evidence.slow_strengths import estimate_slow
from deepir.noise.lines import estimate_line_noise
from deepir.noise.median import median
from deepir.noise.residual import update_noise
from deepir.noise.thin import counted, thinned
from deepir.noise.typical import MAD, typical_noise
from deepir.operators import Warp
from deepir.outliers.defects import OUTLIER, dead, deviating, drawn_over, still
from deepir.penalties.local import Local
from deepir.priors.parts import Part
from deepir.priors.shading import Shading
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
    precision = problem.precision.sum(0) if len(scene) == 1 else thinned(problem.precision)[0]
    average = median(counted(precision, precision > 0)) ** -0.5
    for penalty in problem.penalties["scene"].values() if "scene" in problem.penalties else ():
        noise = average * problem.operator.noise_gain
        if penalty.of_image and isinstance(first, Warp):  # it sees pixels, not the spline's coefficients
            noise /= first.noise_gain
        natural = penalty.natural(noise)
        if isinstance(penalty, Local) and not penalty.follows:  # by places, as the others do
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
    pattern = pattern_left(rest, problem.precision.sign())  # as a float: torch is slow at the bool
    usable = problem.precision > 0
    data, counts = thinned(problem.data, usable)
    used = counted(data, counts)
    rms = float(used.square().mean().sqrt())
    level = rms if problem.reference else float(used.mean().abs())
    for slot, unit, most in (("gain", rms, level), ("offset", 1.0, 1.0)):
        for part in _all_parts(problem, slot):
            if not (part.given or isinstance(part, Shading)):
                found = spread(share(pattern, part)) / 2**0.5
                part.sigma.fill_(found / unit)
                part.most.fill_(MOST * found / most)
    known = usable.any(0, keepdim=True)
    # Of the median, too: one frame does not condemn a pixel.
    middle = rest.where(usable, torch.nan).nanmedian(0, keepdim=True).values.nan_to_num()
    problem.precision.mul_(~(deviating(pattern, known) & deviating(middle, known)))


@torch.no_grad()
def pattern_to_noise(problem: Problem) -> float:
    """How many times stronger than a sample's noise gain and offset are, by the strengths of their parts."""
    data, counts = thinned(problem.data, problem.precision > 0)
    power = {"gain": float(counted(data, counts).square().mean()), "offset": 1.0}
    variances = [
        power[slot] * float(part.sigma) ** 2
        for slot in power
        for part in _all_parts(problem, slot)
        if not isinstance(part, Shading)
    ]
    return sum(variances) ** 0.5 / typical_noise(problem.precision)


@torch.no_grad()
def left(problem: Problem, average: Average | None = None) -> Tensor:
    """What the frames are above their prediction, (N, 1, h, w), once the scene has followed what is no pattern of it.

    An average is smooth: without that step a small bright thing stays in all frames, and passes for what moves.
    `average` spares its computation where it is known.
    """
    values = problem.values()
    rest = problem.data - problem.predict(values)
    weight = problem.precision / problem.precision.amax()
    return problem.beside(values, rest - pattern_left(rest, weight), average)


def pattern_left(rest: Tensor, weight: Tensor) -> Tensor:
    """The mean of that over the frames, (1, 1, h, w), by the weight of their samples."""
    total, share = (torch.zeros_like(rest[:1]) for _ in range(2))
    for rest_k, weight_k in zip(rest, weight, strict=True):  # one at a time stays in the cache
        total.addcmul_(rest_k, weight_k)
        share += weight_k
    return total.div_(share.clamp_(min=1e-6))


@torch.no_grad()
def give_up_dead(problem: Problem, rest: Tensor, noise: float, calm: Tensor) -> None:
    """Give up pixels that are dead, or drawn over; from the edge of a block inwards, for its inside shows itself.

    calm: those that do not change in the frames as they are, (1, 1, h, w); once levels and contrasts are evened out
    others may not.
    """
    usable = problem.precision > 0
    calm = calm | still(problem.data, usable, noise)
    gone = dead(calm, pattern_left(rest, problem.precision.sign()), usable.any(0, keepdim=True))
    if problem.ends is not None:  # a scene beyond the range is as calm
        calm = calm & (problem.ends == 0).all(0, keepdim=True)
    gone |= drawn_over(calm, problem.data - rest, usable, noise)
    problem.precision.mul_(~gone)


@torch.no_grad()
def doubt_misfits(problem: Problem, rest: Tensor) -> None:
    """Let samples count less that neither the scene as it is nor a pattern explains.

    They are badly registered, or what they show moves by itself.
    """
    if problem.noise is not None:
        return
    most = problem.precision.amax()
    rest = rest - pattern_left(rest, problem.precision / most)
    some, known = thinned(rest, problem.precision)
    if (usual := spread(counted(some, known > 0))) > 0:  # one frame leaves nothing
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


def spread(values: Tensor) -> float:
    """Standard deviation of the bulk of the values."""
    return MAD * median((values - median(values)).abs())


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
    estimate_slow(problem)


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
