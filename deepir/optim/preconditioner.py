"""Preconditioners: the curvature of each unknown, and blocks of them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from deepir.arrays.statistics import median_sigma
from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Field
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.drift import Drift
from deepir.fields.line_noise import LineNoise
from deepir.fields.motion import Flow, Motion
from deepir.joint_problem import AnyProblem
from deepir.operators import Lag, Sensor
from deepir.optim.fourier_hessian import (
    N_MOTION_POSITIONS,
    fourier_curvature,
    frequencies,
    has_fourier_model,
    pattern_coupling,
)
from deepir.optim.low_order_model import (
    LowOrderModel,
    Variances,
    additive_variances,
    low_order_inverse_hessian,
    pattern_variances,
)
from deepir.problem import Problem

#: Smallest curvature along a wave, relative to the mean: waves that the motion does not determine must not run to the
#: optimum of a weak prior, which is pattern in the scene.
MIN_SCENE_CURVATURE_RATIO = 0.3
#: The same where lines are strong: such waves are few, and the prior of the lines determines them.
MIN_LINE_CURVATURE_RATIO = 0.03
#: Range of the information on a pixel of the scene, relative to that of typical samples, that is used.
INFORMATION_RANGE = (0.5, 30.0)
#: Upper end of the frequencies that are frozen if only high frequencies are fitted, radians per px.
LOW_FREQUENCY = 1 / 4
MIN_FRAMES_SEEN = 0.2  # number of frames that must show a pixel of the scene for it to be determined


@dataclass(frozen=True)
class _Block:
    """A data set's parameters, as numbers among all, its preconditioner, and that for a known pattern."""

    at: list[int]
    free: Preconditioner
    known: Preconditioner | None


class BlockPreconditioner:
    """Approximate inverse Hessian of data sets that have no moving unknown in common."""

    def __init__(self, blocks: Sequence[_Block], sizes: Sequence[int]) -> None:
        self.blocks, self.sizes = blocks, list(sizes)
        shapes = {each.free.shape for each in blocks}
        self.one_sensor = all(each.known for each in blocks) and len(shapes) == 1

    @property
    def tensors(self) -> dict[str, Tensor]:
        """Those of all blocks."""
        return {f"{i}.{name}": tensor for i, one in enumerate(self._all()) for name, tensor in one.tensors.items()}

    @tensors.setter
    def tensors(self, found: dict[str, Tensor]) -> None:
        for i, one in enumerate(self._all()):
            one.tensors = {name: found[f"{i}.{name}"] for name in one.tensors}

    def _all(self) -> list[Preconditioner]:
        return [one for each in self.blocks for one in (each.free, each.known) if one is not None]

    def solve(self, slope: Tensor) -> Tensor:
        """The approximate inverse Hessian times a flat gradient."""
        given, found = slope.split(self.sizes), torch.zeros_like(slope)
        mine = [[given[i] for i in each.at] for each in self.blocks]
        if self.one_sensor:
            solved = self._of_one_sensor(mine)
        else:
            solved = [_solved(each.free, one) for each, one in zip(self.blocks, mine, strict=True)]
        into = found.split(self.sizes)
        for each, parts in zip(self.blocks, solved, strict=True):
            for i, part in zip(each.at, parts, strict=True):
                into[i].copy_(part)
        return found

    def _of_one_sensor(self, slopes: Sequence[Sequence[Tensor]]) -> list[list[Tensor]]:
        """The scenes' mean and the levels of frames behind a free pattern, all else behind a known one."""
        mean = self._mean(slopes)
        common, rest = [], []
        for each, mine in zip(self.blocks, slopes, strict=True):
            assert each.known is not None
            low = {each.free.scene: mean} | {i: mine[i] for i in each.free.others}
            common.append(_solved(each.free, [low.get(i, torch.zeros_like(one)) for i, one in enumerate(mine)]))
            rest.append(_solved(each.known, [one - low[i] if i in low else one for i, one in enumerate(mine)]))
        shared, extra = self._mean(common), self._mean(rest)
        for each, one, other in zip(self.blocks, common, rest, strict=True):
            one[each.free.scene] = shared
            other[each.free.scene] = other[each.free.scene] - extra
        return [[a + b for a, b in zip(*both, strict=True)] for both in zip(common, rest, strict=True)]

    def _mean(self, parts: Sequence[Sequence[Tensor]]) -> Tensor:
        """The mean of the scenes."""
        return torch.stack([one[each.free.scene] for each, one in zip(self.blocks, parts, strict=True)]).mean(0)


class DiagonalPreconditioner:
    """The mean curvature of the misfit in each tensor of parameters: any operator, any unknowns, in any units."""

    def __init__(self, problem: AnyProblem, parameters: Sequence[nn.Parameter]) -> None:
        curvature = _mean_curvatures(problem, parameters)
        of_scene = max((p.numel() * (c > 0), c) for c, p in zip(curvature.tolist(), parameters, strict=True))[1] or 1.0
        curvature = torch.where(curvature > 0, curvature, of_scene)  # of what penalties alone hold
        # Where the scene follows, an unknown that all samples share has less curvature than alone.
        curvature = torch.where(curvature > of_scene, (curvature * of_scene).sqrt(), curvature)
        scales = [each.new_full((each.numel(),), 1 / float(c)) for c, each in zip(curvature, parameters, strict=True)]
        self.tensors = {"scales": torch.cat(scales).detach()}

    def solve(self, slope: Tensor) -> Tensor:
        """The approximate inverse Hessian times a flat gradient."""
        return slope * self.tensors["scales"]


def _solved(preconditioner: Preconditioner, slopes: Sequence[Tensor]) -> list[Tensor]:
    return list(preconditioner.solve(torch.cat(list(slopes))).split(preconditioner.sizes))


def make_block_preconditioner(
    problem: AnyProblem,
    parameters: Sequence[nn.Parameter],
    eliminated: Collection[str] = (),
    *,
    high_frequencies_only: bool = False,
) -> Preconditioner | BlockPreconditioner | DiagonalPreconditioner:
    """Preconditioner of an optimiser; a diagonal one without a Fourier model of the problem.

    Args:
        problem: Its current values are the point of expansion.
        parameters: Those that the optimiser moves; the scenes' must be among them, and each belongs to one data set.
        eliminated: Unknowns in closed form.
        high_frequencies_only: Leave low frequencies of the scene unchanged.
    """
    blocks, numbers = [], {id(p): i for i, p in enumerate(parameters)}
    for each in problem.data_sets:
        mine = [p for p in each.parameters() if id(p) in numbers]
        mine.sort(key=lambda p: numbers[id(p)])
        own = [name for name, whole in problem.names_in(each).items() if whole in eliminated]
        of_fields = {id(p) for field in each.fields.values() for p in field.parameters()}
        of_scene = {id(p) for p in each.fields["scene"].parameters()}
        if not (has_fourier_model(each) and of_scene & numbers.keys() and {id(p) for p in mine} <= of_fields):
            return DiagonalPreconditioner(problem, parameters)
        free = Preconditioner(each, mine, own, high_frequencies_only=high_frequencies_only)
        known = None
        if own and each.same_sensor:
            known = Preconditioner(each, mine, (), high_frequencies_only=high_frequencies_only)
        blocks.append(_Block([numbers[id(p)] for p in mine], free, known))
    if len(blocks) == 1:
        return blocks[0].free
    several = BlockPreconditioner(blocks, [p.numel() for p in parameters])
    whole = sorted(i for each in blocks for i in each.at) == list(range(len(parameters)))
    return several if whole else DiagonalPreconditioner(problem, parameters)


class Preconditioner:
    """An approximate inverse Hessian for some parameters of a problem, the scene's pixels among them."""

    @torch.no_grad()
    def __init__(
        self,
        problem: Problem,
        parameters: Sequence[nn.Parameter],
        eliminated: Collection[str],
        *,
        high_frequencies_only: bool = False,
    ) -> None:
        # The last field that has a parameter is the member of a sum, not the sum.
        parts = [part for field in problem.fields.values() for part in field.modules()]
        leaves = [part for part in parts if isinstance(part, Field)]
        fields = {id(p): leaf for leaf in leaves for p in leaf.parameters()}
        mine = [fields[id(p)] for p in parameters]
        self.sizes = [p.numel() for p in parameters]
        self.scene = next(i for i, field in enumerate(mine) if field is problem.fields["scene"])
        #: Those of levels and of stray flux, which a slow scene looks like.
        self.others = [i for i, f in enumerate(mine) if isinstance(f, Drift | BasisExpansion) and f.sigma > 0]
        others: Any = [mine[i] for i in self.others]
        # With a known pattern and no stray flux the Fourier model covers low orders, too.
        has_low_order = not high_frequencies_only and (
            bool(eliminated) or any(isinstance(each, BasisExpansion) for each in others)
        )
        self.shape = tuple(parameters[self.scene].shape)
        low_order = LowOrderModel(problem, self.shape) if has_low_order else None
        self.basis = low_order.scene if low_order else None
        self.tensors = _tensors(problem, mine, parameters, low_order, others, eliminated)
        if high_frequencies_only:
            self._freeze_low_frequencies(problem)

    def _freeze_low_frequencies(self, problem: Problem) -> None:
        """Set the inverse curvature to zero at low frequencies and in pixels that hardly any frame shows."""
        found = self.tensors
        seen = _information(problem, median_sigma(problem.precision) ** -2) > MIN_FRAMES_SEEN / len(problem.data)
        for name in {"spectrum", "line_spectrum"} & found.keys():
            found[name] *= ~low_frequencies(self.shape, found[name].device)
        for name in {"sample_scale", "line_scale"} & found.keys():
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
        even = self.tensors["sample_scale"]
        spectrum = torch.fft.rfft2(scene * even).mul_(self.tensors["spectrum"])
        waves = torch.fft.irfft2(spectrum, s=scene.shape).mul_(even)
        if "line_spectrum" in self.tensors:
            bright = self.tensors["line_scale"]
            spectrum = torch.fft.rfft2(scene * bright).mul_(self.tensors["line_spectrum"])
            waves.addcmul_(torch.fft.irfft2(spectrum, s=scene.shape), bright)
        if self.basis is None:
            into[self.scene].copy_(waves.flatten())
            for i in self.others:
                into[i].zero_()
            return found
        in_y, in_x = (each.to(scene) for each in (self.basis.basis_y, self.basis.basis_x))
        terms = (self.basis.order_y, self.basis.order_x)
        low_order = torch.cat([(in_y @ scene @ in_x.T)[terms], *(given[i] for i in self.others)]).double()
        sizes = [len(terms[0]), *(self.sizes[i] for i in self.others)]
        low_order, *others = (self.tensors["low_order"] @ low_order).split(sizes)
        table = scene.new_zeros(len(in_y), len(in_x))
        table[terms] = low_order.to(scene)
        torch.addmm(waves, in_y.T, table @ in_x, out=into[self.scene].view(scene.shape))
        for i, each in zip(self.others, others, strict=True):
            into[i].copy_(each)
        return found


def low_frequencies(shape: Sequence[int], device: torch.device) -> Tensor:
    """Mask of the frequencies below `LOW_FREQUENCY` in a real Fourier transform, (H, W / 2 + 1), bool."""
    y, x = frequencies(shape[-2:], device)
    return y.square() + x.square() < LOW_FREQUENCY**2


@torch.no_grad()
def _tensors(
    problem: Problem,
    fields: Sequence[nn.Module],
    parameters: Sequence[nn.Parameter],
    low_order: LowOrderModel | None,
    others: Sequence[Drift | BasisExpansion],
    eliminated: Collection[str],
) -> dict[str, Tensor]:
    """Tensors of the approximate inverse Hessian.

    Returns:
        `spectrum`: inverse curvature of each wave of the scene, (H, W / 2 + 1).
        `sample_scale`: factor on the scene's pixels before and after the filter, (H, W).
        `scales`: inverse curvature of each other parameter tensor.
        `line_spectrum`, `line_scale`: the same as the first two, for what strong line gains add; only with these.
        `low_order`: inverse of the dense low-order system; only with a `low_order` model.
    """
    value = problem.fields["scene"]()
    precision = median_sigma(problem.precision) ** -2
    pattern, weak = pattern_variances(problem, eliminated), additive_variances(problem, eliminated)
    waves, mean = _clamped_curvature(problem, precision, weak, MIN_SCENE_CURVATURE_RATIO)
    slopes = float(squared_gradient(problem.operator.to_pixels(value)).mean()) / 2
    lags = [name for name, stage in problem.operator.named() if isinstance(stage, Lag)]
    time_constants = [p for name in lags for p in problem.field_of(f"{name}.tau").parameters()]
    scales = []
    for field, parameter in zip(fields, parameters, strict=True):
        curvature = 0.0
        if isinstance(field, Motion | Flow):
            curvature = field.preconditioning_scale**2 * (precision * field.n_samples_affected) * slopes
        elif isinstance(field, LineNoise):
            curvature = field.curvature(precision * problem.data[0].numel())
        if any(parameter is each for each in time_constants):
            curvature = 1 + float(_mean_curvatures(problem, [parameter]))
        scales.append(1 / curvature if curvature > 0 else 1 / mean)
    # The inverse square root of the relative information on each pixel of the scene.
    samples = _information(problem, precision).clamp_(*INFORMATION_RANGE).rsqrt_()
    found = {"spectrum": waves.reciprocal().to(value), "sample_scale": samples}
    found["scales"] = torch.tensor(scales)
    if pattern != weak:
        lines = (
            _clamped_curvature(problem, precision, pattern, MIN_LINE_CURVATURE_RATIO)[0].reciprocal_()
            - waves.reciprocal_()
        )
        found |= {"line_spectrum": lines.to(value), "line_scale": value[0, 0] / value.square().mean().sqrt()}
    return found | (
        {"low_order": low_order_inverse_hessian(problem, low_order, others, eliminated)} if low_order else {}
    )


def _clamped_curvature(problem: Problem, precision: float, pattern: Variances, floor: float) -> tuple[Tensor, float]:
    """Curvature along each wave of the scene's parameters, at least `floor` times its mean; and the mean."""
    scene: Any = problem.fields["scene"]
    shared = sum(pattern_coupling(problem), torch.zeros(())) / N_MOTION_POSITIONS**2 if any(pattern.values()) else None
    (found,) = fourier_curvature(problem, precision, pattern, [shared])
    found *= float(scene.scale) ** 2
    mean = float(found.mean())
    found.clamp_(min=floor * mean)[0, 0] = mean  # the level, which no burst shows, is to stay where it is
    return found, mean


def _information(problem: Problem, precision: float) -> Tensor:
    """Information of the samples on each pixel of the scene, relative to samples of this precision, (H, W)."""
    return scene_information(problem)[0, 0].div_(precision * len(problem.data))


def scene_information(problem: Problem) -> Tensor:
    """Information of the samples on each pixel of the scene, inverse variances, (1, 1, H, W)."""
    slots = {slot: problem.fields[name]() for slot, name in problem.slots.items()}
    weighed = problem.precision * slots.get(problem.slot(Sensor, "gain"), 1.0)  # once more by the adjoint
    return problem.operator.adjoint(weighed, (1, 1, *problem.fields["scene"].shape[-2:]), **slots)


def _mean_curvatures(problem: AnyProblem, parameters: Sequence[nn.Parameter]) -> Tensor:
    """Curvature of the misfit, mean over the elements of each of n parameters, (n,); zero where none is affected.

    By the slopes of four random combinations of the samples (Hutchinson 1989).
    """
    generator, found = torch.Generator().manual_seed(0), torch.zeros(len(parameters))
    for _ in range(4):
        with torch.enable_grad():
            total = torch.zeros(())
            for each in problem.data_sets:
                signs = torch.rand(each.data.shape, generator=generator).sub_(0.5).sign_().to(each.data)
                total = total + (each.fitted().sqrt() * signs * each.predict(each.values())).sum()
        slopes = torch.autograd.grad(total, list(parameters), allow_unused=True)
        found += torch.tensor([0.0 if each is None else float(each.square().mean()) / 4 for each in slopes])
    return found
