"""How the objective curves along the waves of a scene: what L-BFGS starts from in place of the identity.

A camera that moves by `d` px sees a wave of `k` radians a px change by about `k d` of itself, and only what changes
tells the scene from the sensor: along slow waves the objective is so flat that L-BFGS alone takes hundreds of
iterations. With a free pattern of variance V at each pixel, the curvature along a wave is that of `n` frames less what
they share,

    w (n - |Σ_j exp(i k d_j)|² / (n + 1 / (w V))),

less by the spline that the warp samples, and more by the penalties. Where samples are surer than the usual one, by
photons or a known gain, the scene moves by as much less. Lines whose gains differ much leave open what is as bright as
the scene times a wave along them, rather than the wave. Waves longer than the frame, which a Fourier transform does
not have, and the levels of the frames, which look like slopes to a camera that moves, are taken together in a small
dense system.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from deepir.elimination import COLUMN, PIXEL, ROW
from deepir.noise import typical_noise
from deepir.operators import Add, Lag, Sensor, Warp
from deepir.operators.points import displaced
from deepir.penalties.penalty import squared_gradient
from deepir.priors.drift import Drift
from deepir.priors.flow import Flow
from deepir.priors.motion import Motion
from deepir.priors.pixels import Pixels
from deepir.priors.terms import Terms
from deepir.problem import Problem
from deepir.slow import SMOOTH, Slow, Variances, expected, variances

LINES = 0.15  # standard deviation of lines' gains up to which they are taken for additive
PLACES = 5  # along each axis, at which the motion is taken
RIDGE = 1e-8  # least curvature that is known, as a share of the mean
#: Least curvature along a wave that is made use of, as a share of the mean. Waves that the motion leaves open are not
#: to run to where a weak prior has its optimum: pattern in the scene.
FLOOR = 0.3
FLOOR_OF_LINES = 0.03  # those of strong lines are few, and the lines' prior holds them
#: Information of all samples on a pixel of the scene, in that of usual ones, that is made use of.
UNEVEN = (0.5, 30.0)


class Curvature:
    """An approximate inverse Hessian for some parameters of a problem, the scene's pixels among them."""

    @torch.no_grad()
    def __init__(
        self, problem: Problem, parameters: Sequence[nn.Parameter], eliminated: Collection[str]
    ) -> None:
        fields = {id(p): field for field in problem.fields.values() for p in field.parameters()}
        mine = [fields[id(p)] for p in parameters]
        self.sizes = [p.numel() for p in parameters]
        self.scene = next(i for i, field in enumerate(mine) if field is problem.fields["scene"])
        #: Those of levels and of stray flux, which a slow scene looks like.
        self.others = [i for i, f in enumerate(mine) if isinstance(f, Drift | Terms) and f.sigma > 0]
        others: Any = [mine[i] for i in self.others]
        # With the pattern known, and no stray flux, what is slow is nothing special.
        told = bool(eliminated) or any(isinstance(each, Terms) for each in others)
        self.shape = tuple(parameters[self.scene].shape)
        slow = Slow(problem, self.shape) if told else None
        self.basis = slow.scene if slow else None
        self.tensors = _tensors(problem, mine, parameters, slow, others, eliminated)

    @torch.no_grad()
    def solve(self, slope: Tensor) -> Tensor:
        """The approximate inverse Hessian times a flat gradient."""
        found = torch.empty_like(slope)
        given, into = slope.split(self.sizes), found.split(self.sizes)
        for i, scale in enumerate(self.tensors["scales"]):
            if i != self.scene:
                torch.mul(given[i], scale, out=into[i])
        scene = given[self.scene].reshape(self.shape[-2:])
        even = self.tensors["even"]
        spectrum = torch.fft.rfft2(scene * even).mul_(self.tensors["waves"])
        waves = torch.fft.irfft2(spectrum, s=scene.shape).mul_(even)
        if "lines" in self.tensors:
            bright = self.tensors["bright"]
            spectrum = torch.fft.rfft2(scene * bright).mul_(self.tensors["lines"])
            waves.addcmul_(torch.fft.irfft2(spectrum, s=scene.shape), bright)
        if self.basis is None:
            into[self.scene].copy_(waves.flatten())
            for i in self.others:
                into[i].zero_()
            return found
        in_y, in_x = (each.to(scene) for each in (self.basis.in_y, self.basis.in_x))
        terms = (self.basis.of_y, self.basis.of_x)
        slow = torch.cat([(in_y @ scene @ in_x.T)[terms], *(given[i] for i in self.others)]).double()
        sizes = [len(terms[0]), *(self.sizes[i] for i in self.others)]
        slow, *others = (self.tensors["slow"] @ slow).split(sizes)
        table = scene.new_zeros(len(in_y), len(in_x))
        table[terms] = slow.to(scene)
        torch.addmm(waves, in_y.T, table @ in_x, out=into[self.scene].view(scene.shape))
        for i, each in zip(self.others, others, strict=True):
            into[i].copy_(each)
        return found


def curvature(
    problem: Problem, parameters: Sequence[nn.Parameter], eliminated: Collection[str] = ()
) -> Curvature | None:
    """For pixels that a moving sensor sees; None where the parameters or the physics are others."""
    of_fields = {id(p) for field in problem.fields.values() for p in field.parameters()}
    of_scene = {id(p) for p in problem.fields["scene"].parameters()}
    mine = {id(p) for p in parameters}
    known = mine <= of_fields and bool(mine & of_scene)  # a penalty may have unknowns of its own
    return Curvature(problem, parameters, eliminated) if known and modelled(problem) else None


def modelled(problem: Problem) -> bool:
    """Whether the model holds: for pixels that a moving sensor sees."""
    stages = [type(stage) for _, stage in problem.operator.named() if not isinstance(stage, Lag)]
    moving = stages in ([Warp, Sensor], [Warp, Add, Sensor]) and len(problem.data) > 1
    return moving and isinstance(problem.fields["scene"], Pixels)


def unsureness(problem: Problem, eliminated: Collection[str], weak: float = 1.0) -> Tensor | None:
    """Variance along each wave of a real Fourier transform, in units of the scene; None as for `curvature`.

    The mean over the frame: where the camera turns, other waves are open at other places. With `weak` times the
    scene's penalties. Strong lines are left out: where the scene is bright and dark, their gains are told from it.
    """
    if not modelled(problem):
        return None
    precision = typical_noise(problem.precision) ** -2
    common = _common(problem) if eliminated else (None,)
    found = [
        here.clamp_(min=RIDGE * float(here.mean())).reciprocal_()
        for here in _waves(problem, precision, variances(problem, eliminated, LINES), common, weak)
    ]
    return sum(found[1:], found[0]) / len(found)


def spline_response(problem: Problem) -> Tensor:
    """Squared response, along each wave, of the spline at the pixels to its coefficients."""
    return _response(*_frequencies(problem.fields["scene"].shape[-2:], problem.data.device))


@torch.no_grad()
def _tensors(
    problem: Problem,
    fields: Sequence[nn.Module],
    parameters: Sequence[nn.Parameter],
    slow: Slow | None,
    others: Sequence[Drift | Terms],
    eliminated: Collection[str],
) -> dict[str, Tensor]:
    """Inverse curvatures: `waves` (H, W / 2 + 1), `even` (H, W) before and after; of all others; of what is slow.

    Where lines' gains differ much, what they add to that of the waves, `lines`, `bright` (H, W) before and after.
    """
    value = problem.fields["scene"]()
    precision = typical_noise(problem.precision) ** -2
    pattern, additive = variances(problem, eliminated), variances(problem, eliminated, LINES)
    waves, mean = _floored(problem, precision, additive, FLOOR)
    slopes = float(squared_gradient(problem.operator.image(value)).mean()) / 2
    scales = []
    for field, parameter in zip(fields, parameters, strict=True):
        moves = isinstance(field, Motion | Flow)
        known = field.step**2 * (precision * field.felt) * slopes if moves else 0.0  # type: ignore[operator]
        known = _measured(problem, parameter) if _lags(problem, parameter) else known
        scales.append(1 / known if known > 0 else 1 / mean)
    found = {"waves": waves.reciprocal().to(value), "even": _even(problem, precision)}
    found["scales"] = torch.tensor(scales)
    if pattern != additive:
        lines = _floored(problem, precision, pattern, FLOOR_OF_LINES)[0].reciprocal_() - waves.reciprocal_()
        found |= {"lines": lines.to(value), "bright": value[0, 0] / value.square().mean().sqrt()}
    return found | ({"slow": _slow(problem, slow, others, eliminated)} if slow else {})


def _floored(problem: Problem, precision: float, pattern: Variances, floor: float) -> tuple[Tensor, float]:
    """Curvature along each wave of the scene's parameters, none far below the mean; and the mean."""
    scene: Any = problem.fields["scene"]
    common = sum(_common(problem), torch.zeros(())) / PLACES**2 if any(pattern.values()) else None
    (found,) = _waves(problem, precision, pattern, [common])
    found *= float(scene.scale) ** 2
    mean = float(found.mean())
    found.clamp_(min=floor * mean)[0, 0] = mean  # the level, which no burst shows, is to stay where it is
    return found, mean


def _even(problem: Problem, precision: float) -> Tensor:
    """Square root of what usual samples would say of each pixel of the scene, in what these say, (H, W)."""
    slots = {slot: problem.fields[name]() for slot, name in problem.slots.items()}
    weighed = problem.precision * slots["sensor.gain"]  # once more by the adjoint
    canvas = (1, 1, *problem.fields["scene"].shape[-2:])
    told = problem.operator.adjoint(weighed, canvas, **slots)[0, 0]
    return told.div_(precision * len(weighed)).clamp_(*UNEVEN).rsqrt_()


def _lags(problem: Problem, parameter: nn.Parameter) -> bool:
    """Whether it is one of a lag's time constant."""
    slots = [f"{name}.tau" for name, stage in problem.operator.named() if isinstance(stage, Lag)]
    return any(
        parameter is each for slot in slots for each in problem.fields[problem.slots[slot]].parameters()
    )


def _measured(problem: Problem, parameter: nn.Parameter) -> float:
    """Curvature in each element, if they change different samples: by a small change of all of them."""
    before = problem.predict(problem.values())
    change = 1e-2 * float(parameter.abs().amax().clamp(min=1))
    parameter.add_(change)
    slope = problem.predict(problem.values()).sub_(before).div_(change)
    parameter.sub_(change)
    return 1 + float((problem.fitted() * slope.square()).sum()) / parameter.numel()


def _waves(
    problem: Problem,
    precision: float,
    pattern: Variances,
    commons: Iterable[Tensor | None],
    weak: float = 1.0,
) -> Iterator[Tensor]:
    """Curvature along each wave of a real Fourier transform, (H, W / 2 + 1), in units of the scene.

    For samples of this `precision`, and each of what the frames may share, see `_common`; None where no pattern is
    free.
    """
    scene, count = problem.fields["scene"](), len(problem.data)
    y, x = _frequencies(scene.shape[-2:], scene.device)
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    stiffness = [penalty.stiffness(scene) for penalty in penalties]
    of_value, of_gradient = (weak * sum(each) for each in zip((0.0, 0.0), *stiffness, strict=True))
    share = _shared(pattern, precision, count, scene.shape[-2:], y, x).reciprocal_()
    y, x = y.float(), x.float()
    told = precision * _response(y, x)
    whole = count * told + of_value + of_gradient * (4 - 2 * x.cos() - 2 * y.cos())
    share *= told
    for common in commons:
        yield whole if common is None else torch.addcmul(whole, common, share, value=-1)


def _response(y: Tensor, x: Tensor) -> Tensor:
    return ((2 + y.cos()) / 3 * (2 + x.cos()) / 3).square()


def _shared(
    variance: Variances,
    precision: float,
    count: int,
    size: Sequence[int],
    y: Tensor,
    x: Tensor,
) -> Tensor:
    """`n + 1 / (w V)` for each wave: a pattern constant along columns is all in the waves that are so, too."""
    height, width = size
    # In part also in their neighbours: the camera moves over them.
    columns = height * variance[COLUMN] / (math.pi * (1 + (y * height / (2 * math.pi)).square()))
    rows = width * variance[ROW] / (math.pi * (1 + (x * width / (2 * math.pi)).square()))
    each = (variance[PIXEL] + columns).float() + rows.float()
    return count + 1 / (precision * each).clamp(min=1e-9)


def _common(problem: Problem) -> Iterator[Tensor]:
    """`|Σ_j exp(i k d_j)|²` of each wave at places of the frame: where the camera turns, d differs among them."""
    y, x = _frequencies(problem.fields["scene"].shape[-2:], problem.data.device)
    motion = problem.fields[problem.slots["warp.motion"]]().double()
    height, width = problem.data.shape[-2:]
    parts = torch.linspace(-0.4, 0.4, PLACES, dtype=y.dtype, device=y.device)
    for at in torch.cartesian_prod(parts * width, parts * height):
        shift = displaced(motion, at)
        along_y, along_x = y * shift[:, 1], x * shift[:, :1]  # (ny, N) and (N, nx)
        cos, sin = along_y.cos().float(), along_y.sin().float()
        both = torch.cat((along_x.cos(), along_x.sin())).float()
        real, imaginary = torch.cat((cos, -sin), 1) @ both, torch.cat((sin, cos), 1) @ both
        yield real.square_().addcmul_(imaginary, imaginary)


def _frequencies(size: Sequence[int], device: torch.device) -> tuple[Tensor, Tensor]:
    """Of the waves of a real Fourier transform, radians a px: (H, 1) and (W / 2 + 1,)."""
    height, width = size
    y = 2 * math.pi * torch.fft.fftfreq(height, dtype=torch.float64, device=device)[:, None]
    return y, 2 * math.pi * torch.fft.rfftfreq(width, dtype=torch.float64, device=device)


def _slow(
    problem: Problem, slow: Slow, others: Sequence[Drift | Terms], eliminated: Collection[str]
) -> Tensor:
    """Inverse of the dense system of the scene's polynomials and, where they are free, frames' levels and stray flux.

    The pattern's own polynomials are eliminated, with what its parts let expect of them: where the motion leaves
    open whether scene or pattern has a slope, that is all there is to hold it.
    """
    scene: Any = problem.fields["scene"]
    terms = len(slow.scene.white)
    found = variances(problem, eliminated, LINES)
    maps = [slow.levels() if isinstance(each, Drift) else slow.of_terms(each)[0] for each in others]
    whole = slow.normal(*maps)
    unit = whole.new_full((len(whole),), float(scene.scale))
    at = 2 * terms + 1
    for each, made in zip(others, maps, strict=True):
        mine = slice(at, at := at + made.shape[-1])
        unit[mine] = float(each.step)
        if isinstance(each, Terms):
            whole[mine, mine] += _rest(problem, slow, each, found)
        else:  # what all levels have in common is nothing, and would be all that the inverse has digits for
            whole[mine, mine] += whole[mine, mine].diagonal().mean() / made.shape[-1]
    spread = expected(found, slow.frame) + found[SMOOTH] * slow.frame.share.square()
    whole.diagonal()[terms + 1 : 2 * terms + 1] += 1 / spread.clamp(min=1e-30)  # the pattern's level is free
    whole[:terms, :terms] += _stiffness(problem, slow)
    pattern = torch.arange(len(whole), device=whole.device)
    pattern = (pattern >= terms) & (pattern <= 2 * terms)
    held, shared = whole[pattern][:, pattern], whole[pattern][:, ~pattern]
    system = whole[~pattern][:, ~pattern] - shared.T @ torch.linalg.solve(held, shared)
    unit = unit[~pattern]
    system = unit[:, None] * system * unit
    system.diagonal().add_(RIDGE * system.diagonal().mean())
    # As it lies in a checkpoint: the order of the sums of its products follows from it.
    return torch.linalg.inv(system).contiguous()


def _rest(problem: Problem, slow: Slow, field: Terms, variance: Variances) -> Tensor:
    """Curvature of stray flux in its prior and in what is not slow of it, behind a free pattern: a matrix."""
    _, rest = slow.of_terms(field)
    height, width = problem.data.shape[-2:]
    unsure = typical_noise(problem.precision) ** 2 / len(problem.data) + variance[PIXEL]
    columns, rows = rest.mean(1, keepdim=True).expand_as(rest), rest.mean(2, keepdim=True).expand_as(rest)
    told = torch.eye(len(rest), dtype=rest.dtype, device=rest.device) / field.sigma.double().square()
    for part, more in (
        (rest - columns - rows, 0.0),
        (columns, height * variance[COLUMN]),
        (rows, width * variance[ROW]),
    ):
        flat = part.flatten(1)
        told += height * width / (unsure + more) * flat @ flat.T / flat.shape[1]
    return told


def _stiffness(problem: Problem, slow: Slow) -> Tensor:
    """What the scene's penalties make of its polynomials: a matrix."""
    value = problem.fields["scene"]()
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    stiffness = [penalty.stiffness(value) for penalty in penalties]
    of_value, of_gradient = (sum(each) for each in zip((0.0, 0.0), *stiffness, strict=True))
    basis = slow.scene  # of products of functions of y and of x, whose sums are products, too
    (y, down), (x, right) = (
        [each @ each.T for each in (along[of], along[of].diff(dim=-1))]
        for along, of in ((basis.in_y, basis.of_y), (basis.in_x, basis.of_x))
    )
    return of_value * y * x + of_gradient * (y * right + down * x)
