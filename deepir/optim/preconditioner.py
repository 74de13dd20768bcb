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

from collections.abc import Collection, Iterator, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from deepir.arrays.differences import squared_gradient
from deepir.arrays.noise_level import median_sigma
from deepir.fields.base import Field
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.dense_motion import Flow
from deepir.fields.drift import Drift
from deepir.fields.line_noise import LineNoise
from deepir.fields.motion import Motion
from deepir.operators import Lag, Sensor
from deepir.optim.fourier_hessian import (
    PLACES,
    additive,
    along_waves,
    frequencies,
    has_fourier_model,
    pattern_coupling,
)
from deepir.optim.low_order_hessian import low_order_inverse_hessian
from deepir.optim.low_order_model import LowOrderModel, Variances, variances
from deepir.problem import Problem

#: Least curvature along a wave that is made use of, as a share of the mean. Waves that the motion leaves open are not
#: to run to where a weak prior has its optimum: pattern in the scene.
FLOOR = 0.3
FLOOR_OF_LINES = 0.03  # those of strong lines are few, and the lines' prior holds them
#: Information of all samples on a pixel of the scene, in that of usual ones, that is made use of.
UNEVEN = (0.5, 30.0)
SLOW = 1 / 4  # radians a px: waves that are slower stay as they are where only the fine ones are asked for


class Preconditioner:
    """An approximate inverse Hessian for some parameters of a problem, the scene's pixels among them."""

    @torch.no_grad()
    def __init__(
        self,
        problem: Problem,
        parameters: Sequence[nn.Parameter],
        eliminated: Collection[str],
        *,
        fine: bool = False,
    ) -> None:
        fields = {id(p): field for field in innermost(problem) for p in field.parameters()}
        mine = [fields[id(p)] for p in parameters]
        self.sizes = [p.numel() for p in parameters]
        self.scene = next(i for i, field in enumerate(mine) if field is problem.fields["scene"])
        #: Those of levels and of stray flux, which a slow scene looks like.
        self.others = [i for i, f in enumerate(mine) if isinstance(f, Drift | BasisExpansion) and f.sigma > 0]
        others: Any = [mine[i] for i in self.others]
        # With the pattern known, and no stray flux, what is slow is nothing special.
        told = not fine and (bool(eliminated) or any(isinstance(each, BasisExpansion) for each in others))
        self.shape = tuple(parameters[self.scene].shape)
        slow = LowOrderModel(problem, self.shape) if told else None
        self.basis = slow.scene if slow else None
        self.tensors = _tensors(problem, mine, parameters, slow, others, eliminated)
        if fine:
            self._hold_slow(problem)

    def _hold_slow(self, problem: Problem) -> None:
        """No step along slow waves, nor where hardly a frame looks: what is done there is made up for elsewhere."""
        found = self.tensors
        seen = _information(problem, median_sigma(problem.precision) ** -2) > MIN_FRAMES_SEEN / len(
            problem.data
        )
        for name in {"waves", "lines"} & found.keys():
            found[name] *= ~slow_waves(self.shape, found[name].device)
        for name in {"even", "bright"} & found.keys():
            found[name] *= seen

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
        in_y, in_x = (each.to(scene) for each in (self.basis.basis_y, self.basis.basis_x))
        terms = (self.basis.order_y, self.basis.order_x)
        slow = torch.cat([(in_y @ scene @ in_x.T)[terms], *(given[i] for i in self.others)]).double()
        sizes = [len(terms[0]), *(self.sizes[i] for i in self.others)]
        slow, *others = (self.tensors["slow"] @ slow).split(sizes)
        table = scene.new_zeros(len(in_y), len(in_x))
        table[terms] = slow.to(scene)
        torch.addmm(waves, in_y.T, table @ in_x, out=into[self.scene].view(scene.shape))
        for i, each in zip(self.others, others, strict=True):
            into[i].copy_(each)
        return found


def innermost(problem: Problem) -> Iterator[Field]:
    """The fields, and after each those that it is a sum of."""
    for field in problem.fields.values():
        yield from (module for module in field.modules() if isinstance(module, Field))


def curvature(
    problem: Problem,
    parameters: Sequence[nn.Parameter],
    eliminated: Collection[str] = (),
    *,
    fine: bool = False,
) -> Preconditioner | None:
    """For pixels that a moving sensor sees; None where the parameters or the physics are others."""
    of_fields = {id(p) for field in problem.fields.values() for p in field.parameters()}
    of_scene = {id(p) for p in problem.fields["scene"].parameters()}
    mine = {id(p) for p in parameters}
    known = mine <= of_fields and bool(mine & of_scene)  # a penalty may have unknowns of its own
    return (
        Preconditioner(problem, parameters, eliminated, fine=fine)
        if known and has_fourier_model(problem)
        else None
    )


def slow_waves(shape: Sequence[int], device: torch.device) -> Tensor:
    """The waves of a real Fourier transform, (H, W / 2 + 1) bool, that are slow."""
    y, x = frequencies(shape[-2:], device)
    return y.square() + x.square() < SLOW**2


@torch.no_grad()
def _tensors(
    problem: Problem,
    fields: Sequence[nn.Module],
    parameters: Sequence[nn.Parameter],
    slow: LowOrderModel | None,
    others: Sequence[Drift | BasisExpansion],
    eliminated: Collection[str],
) -> dict[str, Tensor]:
    """Inverse curvatures: `waves` (H, W / 2 + 1), `even` (H, W) before and after; of all others; of what is slow.

    Where lines' gains differ much, what they add to that of the waves, `lines`, `bright` (H, W) before and after.
    """
    value = problem.fields["scene"]()
    precision = median_sigma(problem.precision) ** -2
    pattern, weak = variances(problem, eliminated), additive(problem, eliminated)
    waves, mean = _floored(problem, precision, weak, FLOOR)
    slopes = float(squared_gradient(problem.operator.to_pixels(value)).mean()) / 2
    scales = []
    for field, parameter in zip(fields, parameters, strict=True):
        curvature = 0.0
        if isinstance(field, Motion | Flow):
            curvature = field.preconditioning_scale**2 * (precision * field.n_samples_affected) * slopes
        elif isinstance(field, LineNoise):
            curvature = field.curvature(precision * problem.data[0].numel())
        if _is_time_constant(problem, parameter):
            curvature = _measured_curvature(problem, parameter)
        scales.append(1 / curvature if curvature > 0 else 1 / mean)
    found = {"waves": waves.reciprocal().to(value), "even": _even(problem, precision)}
    found["scales"] = torch.tensor(scales)
    if pattern != weak:
        lines = _floored(problem, precision, pattern, FLOOR_OF_LINES)[0].reciprocal_() - waves.reciprocal_()
        found |= {"lines": lines.to(value), "bright": value[0, 0] / value.square().mean().sqrt()}
    return found | ({"slow": low_order_inverse_hessian(problem, slow, others, eliminated)} if slow else {})


def _floored(problem: Problem, precision: float, pattern: Variances, floor: float) -> tuple[Tensor, float]:
    """Curvature along each wave of the scene's parameters, none far below the mean; and the mean."""
    scene: Any = problem.fields["scene"]
    shared = sum(pattern_coupling(problem), torch.zeros(())) / PLACES**2 if any(pattern.values()) else None
    (found,) = along_waves(problem, precision, pattern, [shared])
    found *= float(scene.scale) ** 2
    mean = float(found.mean())
    found.clamp_(min=floor * mean)[0, 0] = mean  # the level, which no burst shows, is to stay where it is
    return found, mean


def _even(problem: Problem, precision: float) -> Tensor:
    """Square root of what usual samples would say of each pixel of the scene, in what these say, (H, W)."""
    return _information(problem, precision).clamp_(*UNEVEN).rsqrt_()


def _information(problem: Problem, precision: float) -> Tensor:
    """What all samples say of each pixel of the scene, in what usual ones of this precision would, (H, W)."""
    slots = {slot: problem.fields[name]() for slot, name in problem.slots.items()}
    weighed = problem.precision * slots.get(problem.slot(Sensor, "gain"), 1.0)  # once more by the adjoint
    canvas = (1, 1, *problem.fields["scene"].shape[-2:])
    told: Tensor = problem.operator.adjoint(weighed, canvas, **slots)[0, 0]
    return told.div_(precision * len(weighed))


def _is_time_constant(problem: Problem, parameter: nn.Parameter) -> bool:
    """Whether it is one of a lag's time constant."""
    slots = [f"{name}.tau" for name, stage in problem.operator.named() if isinstance(stage, Lag)]
    return any(parameter is each for slot in slots for each in problem.field_of(slot).parameters())


def _measured_curvature(problem: Problem, parameter: nn.Parameter) -> float:
    """Curvature in each element, if they change different samples: by a small change of all of them."""
    before = problem.predict(problem.values())
    change = 1e-2 * float(parameter.abs().amax().clamp(min=1))
    parameter.add_(change)
    slope = problem.predict(problem.values()).sub_(before).div_(change)
    parameter.sub_(change)
    return 1 + float((problem.fitted() * slope.square()).sum()) / parameter.numel()


MIN_FRAMES_SEEN = 0.2  # frames that must show a pixel of the scene, for it to be known
