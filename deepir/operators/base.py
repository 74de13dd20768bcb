"""The interface of operators, their chains, and motions over time."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from deepir.operators.linear import Linear, Shape, identity


@dataclass(frozen=True)
class Trajectory:
    """Instants at which an operator needs its input; by default those of the frames."""

    steps: int = 1  # instants per frame after the first
    n_before: int = 0  # instants before the first frame

    def count(self, n_frames: int) -> int:
        """Number of instants for a number of frames."""
        return self.n_before + (n_frames - 1) * self.steps + 1

    def frames(self, count: int) -> int:
        """Number of frames for a number of instants."""
        return (count - 1 - self.n_before) // self.steps + 1

    def interpolate(self, motion: Tensor) -> Tensor:
        """Motions at the instants, (instants, ...), on the cubic spline through those of the frames, (N, ...)."""
        if self == Trajectory():
            return motion
        weights = _weights(self, len(motion)).to(motion)
        return (weights @ motion.flatten(1)).unflatten(1, motion.shape[1:])


class Operator(nn.Module):
    """A map `x, **slots -> y` without hidden state; `deepir.testing.check_operator` checks one.

    Slots are named extra tensors (`motion`, `gain`, `psf` ...): an operator is independent of the parametrisation of
    the unknowns.
    """

    linear: bool = True  # whether it is linear in `x` for fixed slots
    affine: bool = True  # whether it is linear in `x` up to a constant (an offset)
    #: The value of each slot that leaves the data unchanged (1 for a gain, 0 for an offset).
    neutral: ClassVar[Mapping[str, float]] = {}
    #: Standard deviation of the inverse-filtered white noise of the output, relative to that of the output.
    noise_gain: float = 1.0
    moves: ClassVar[bool] = False  # whether the slot `motion` moves the sampling points of each frame
    #: Whether each sample of the output depends on the sample of the input at the same place and time only.
    pointwise: ClassVar[bool] = False
    temporal: ClassVar[bool] = False  # whether samples depend on earlier samples of the same pixel, and on nothing else
    keeps_grid: ClassVar[bool] = False  # whether the output's pixels lie at the input's; the reach of a blur aside
    trajectory: Trajectory = Trajectory()  # the instants at which it needs its input
    example_shape: ClassVar[Shape] = (1, 1, 4, 5)  # shape of the input, options and number of frames of `example`
    example_options: ClassVar[Mapping[str, Any]] = {}
    example_frames: ClassVar[int] = 3

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """Name and shape of each slot, for an input of `x_shape` and a burst of `n_frames`."""
        return {}

    def fits(self, slot: str, wanted: Shape, found: Shape) -> bool:
        """Whether a slot of shape `wanted` (from `slots`) accepts a value of shape `found`."""
        return found == wanted

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Shape of the output for an input of `x_shape`."""
        return x_shape

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """(height, width) of the input that gives an output of `out_size`; the inverse of `out_shape`."""
        return out_size

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Apply the operator."""
        raise NotImplementedError

    def adjoint(self, y: Tensor, x_shape: Shape, **slots: Tensor) -> Tensor:
        """Adjoint of the linear part; of the derivative at zero if the operator is not affine.

        Args:
            y: (N, C, h, w).
            x_shape: Shape of the input.
            slots: Values of the slots.

        Returns:
            A tensor of `x_shape`.
        """
        x = torch.zeros(x_shape, dtype=y.dtype, device=y.device, requires_grad=True)
        with torch.enable_grad():
            # The gradient of <A x, y>; handing y to autograd.grad makes torch import sympy, 0.3 s on the first call.
            (out,) = torch.autograd.grad((self.forward(x, **slots) * y).sum(), x)
        return out

    def at(self, x: Tensor | Shape | None = None, **slots: Tensor) -> Linear:
        """The linear map at given slots; of an operator that is not affine its derivative at `x`.

        Args:
            x: Shape of the input, (N or 1, C, H, W), or an input: where the operator is linearised. None: the map takes
                any input that fits.
            slots: Values of the slots; those that are missing are neutral. A chain's are given by
                `**{"warp.motion": motion}`.

        Raises:
            ValueError: It is not linear up to a constant, and `x` is not an input.
        """
        name, shape = type(self).__name__, tuple(x.shape) if isinstance(x, Tensor) else x
        if not self.affine:
            if not isinstance(x, Tensor):
                raise ValueError(f"{name.lower()} is not linear, nor linear up to a constant: give `at` an input")
            return self._derivative(x.detach(), slots)

        def forward(x: Tensor) -> Tensor:
            constant = 0 if self.linear else self(torch.zeros_like(x), **slots)
            return self(x, **slots) - constant

        def adjoint(y: Tensor) -> Tensor:
            zero = y.new_zeros(shape or self._in_shape(tuple(y.shape)))
            return self.adjoint(y, tuple(zero.shape), **self._with_neutral(zero, slots))

        out_shape = None
        if shape is not None:
            kind = next(iter(slots.values()), torch.zeros(()))
            with torch.no_grad():
                out_shape = tuple(self(kind.new_zeros(shape), **slots).shape)
        return Linear(forward, adjoint, shape, out_shape, name)

    def _derivative(self, at: Tensor, slots: dict[str, Tensor]) -> Linear:
        """The derivative at an input, by automatic differentiation."""

        def forward(v: Tensor) -> Tensor:
            found: Tensor = torch.func.jvp(lambda x: self(x, **slots), (at,), (v,))[1]
            return found

        def adjoint(y: Tensor) -> Tensor:
            x = at.clone().requires_grad_()
            with torch.enable_grad():
                return torch.autograd.grad((self(x, **slots) * y).sum(), x)[0]

        with torch.no_grad():
            out_shape = tuple(self(at, **slots).shape)
        return Linear(forward, adjoint, tuple(at.shape), out_shape, type(self).__name__)

    def _in_shape(self, out_shape: Shape) -> Shape:
        """Shape of the input for an output of a shape: one scene for all frames, if the operator makes frames."""
        frames, channels, *size = out_shape
        shape = (1, channels, *self.in_size((size[0], size[1])))
        makes_frames = self.out_shape(shape, frames)[0] == frames
        return shape if makes_frames else (self.trajectory.count(frames), *shape[1:])

    def __call__(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Apply the operator; slots that are missing are neutral."""
        found: Tensor = super().__call__(x, **self._with_neutral(x, slots))
        return found

    def _with_neutral(self, x: Tensor, slots: dict[str, Tensor]) -> dict[str, Tensor]:
        """The slots, and neutral values for those that are missing and have one."""
        missing = self.neutral.keys() - slots.keys()
        shapes = self.slots(tuple(x.shape), len(x)) if missing else {}
        return slots | {name: x.new_full(shapes[name], self.neutral[name]) for name in missing}

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Mask (0 or 1) of the outputs that depend on valid inputs only; `mask` has the shape of `x`."""
        return mask

    def to_pixels(self, x: Tensor) -> Tensor:
        """Samples of the input at pixel centres; differs from `x` if this holds spline coefficients."""
        return x

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """A small instance with random input and slots (float64): the test-suite collects it from the registry."""
        operator, generator = cls(**cls.example_options), torch.Generator().manual_seed(0)
        shapes = {"": cls.example_shape} | operator.slots(cls.example_shape, cls.example_frames)
        slots = {name: torch.rand(shape, generator=generator, dtype=torch.float64) for name, shape in shapes.items()}
        return operator, slots.pop(""), slots

    def __matmul__(self, other: Operator) -> Chain:
        """`B @ A` applies `A` first."""
        first = _stages(other)
        return Chain(first | _stages(self, taken=first))


class Chain(Operator):
    """Stages applied in order; slots are named `stage.slot`."""

    def __init__(self, stages: Mapping[str, Operator]) -> None:
        super().__init__()
        self.stages = nn.ModuleDict(stages)
        self.linear = all(stage.linear for stage in stages.values())
        self.affine = all(stage.affine for stage in stages.values())
        self.noise_gain = math.prod(stage.noise_gain for stage in stages.values())

    @classmethod
    def of(cls, operator: Operator) -> Chain:
        """One of a single stage, which has the name of its class."""
        return cls(_stages(operator))

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """Slots of all stages, as `stage.slot`."""
        found: dict[str, Shape] = {}
        for name, stage in self.named():
            found |= {f"{name}.{slot}": shape for slot, shape in stage.slots(x_shape, n_frames).items()}
            x_shape = stage.out_shape(x_shape, n_frames)
        return found

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Shape after the last stage."""
        for _, stage in self.named():
            x_shape = stage.out_shape(x_shape, n_frames)
        return x_shape

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """Size before the first stage."""
        for _, stage in reversed(self.named()):
            out_size = stage.in_size(out_size)
        return out_size

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Apply every stage with its own slots."""
        for name, stage in self.named():
            x = stage(x, **slots_of(slots, name))
        return x

    def at(self, x: Tensor | Shape | None = None, **slots: Tensor) -> Linear:
        """The product of the stages' linear maps, each at the input that it gets."""
        if self.affine or not isinstance(x, Tensor):
            return super().at(x, **slots)
        product = identity(tuple(x.shape))
        for name, stage in self.named():
            product = stage.at(x, **slots_of(slots, name)) @ product
            x = stage(x, **slots_of(slots, name))
        return product

    def adjoint(self, y: Tensor, x_shape: Shape, **slots: Tensor) -> Tensor:
        """Adjoints of the stages in reverse order, if all are affine."""
        if not self.affine:
            return super().adjoint(y, x_shape, **slots)
        shapes = [x_shape]
        for _, stage in self.named()[:-1]:
            shapes.append(stage.out_shape(shapes[-1], len(y)))
        for (name, stage), shape in zip(reversed(self.named()), reversed(shapes), strict=True):
            y = stage.adjoint(y, shape, **slots_of(slots, name))
        return y

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Validity after the last stage."""
        for name, stage in self.named():
            mask = stage.valid(mask, **slots_of(slots, name))
        return mask

    def to_pixels(self, x: Tensor) -> Tensor:
        """Samples at pixel centres by the first stage."""
        return self.named()[0][1].to_pixels(x)

    def _with_neutral(self, x: Tensor, slots: dict[str, Tensor]) -> dict[str, Tensor]:
        for name in slots:
            if name.partition(".")[0] not in self.stages:
                known = ", ".join(self.slots(tuple(x.shape), len(x)))
                raise ValueError(f"no slot {name!r} in this chain, which has: {known}")
        return slots

    def named(self) -> list[tuple[str, Operator]]:
        """(name, stage), in the order of application."""
        return list(self.stages.items())  # type: ignore[arg-type]


def slots_of(slots: Mapping[str, Tensor], stage: str) -> dict[str, Tensor]:
    """The slots of one stage, without its name: `{"warp.motion": m} -> {"motion": m}`."""
    prefix = f"{stage}."
    return {name.removeprefix(prefix): value for name, value in slots.items() if name.startswith(prefix)}


def _stages(operator: Operator, taken: Mapping[str, Operator] | None = None) -> dict[str, Operator]:
    """Stages of a chain, or the operator as a stage named after its class; a name in use gets a number."""
    single = {type(operator).__name__.lower(): operator}
    stages = dict(operator.named()) if isinstance(operator, Chain) else single
    named: dict[str, Operator] = {}
    for name, stage in stages.items():
        unique, count = name, 2
        while unique in named or unique in (taken or {}):
            unique, count = f"{name.rstrip('0123456789')}{count}", count + 1
        named[unique] = stage
    return named


@functools.lru_cache(maxsize=16)
def _weights(path: Trajectory, n_frames: int) -> Tensor:
    """Interpolation weights, (instants, N)."""
    if n_frames == 1:
        return torch.ones(path.count(1), 1, dtype=torch.float64)
    from scipy.interpolate import CubicSpline  # most runs need none

    at = (np.arange(path.count(n_frames)) - path.n_before) / path.steps
    return torch.from_numpy(CubicSpline(np.arange(n_frames), np.eye(n_frames))(at))
