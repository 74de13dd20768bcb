"""The interface of operators, their chains, and motions over time."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Trajectory:
    """Instants at which an operator needs its input; by default those of the frames.

    Attributes:
        steps: Instants per frame after the first.
        n_before: Instants before the first frame.
    """

    steps: int = 1
    n_before: int = 0

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

    #: Whether it is linear in `x` for fixed slots.
    linear: bool = True
    #: Whether it is linear in `x` up to a constant (an offset).
    affine: bool = True
    #: The value of each slot that leaves the data unchanged (1 for a gain, 0 for an offset).
    neutral: ClassVar[Mapping[str, float]] = {}
    #: Standard deviation of the inverse-filtered white noise of the output, relative to that of the output.
    noise_gain: float = 1.0
    #: Whether the slot `motion` moves the sampling points of each frame.
    moves: ClassVar[bool] = False
    #: Whether each sample of the output depends on the sample of the input at the same place and time only.
    pointwise: ClassVar[bool] = False
    #: Whether samples depend on earlier samples of the same pixel, and on nothing else.
    temporal: ClassVar[bool] = False
    #: Whether the output's pixels lie at the input's; the reach of a blur aside.
    keeps_grid: ClassVar[bool] = False
    #: The instants at which it needs its input.
    trajectory: Trajectory = Trajectory()

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

    def as_linear_operator(
        self, x_shape: Shape, *, dtype: torch.dtype = torch.float64, **slots: Tensor
    ) -> LinearOperator:
        """The linear part as `scipy.sparse.linalg.LinearOperator`, with its adjoint, on flattened arrays.

        Args:
            x_shape: Shape of the input, (N or 1, C, H, W).
            dtype: In which it computes.
            slots: Values of the slots; a chain's are given by `**{"warp.motion": motion}`.

        Raises:
            ValueError: It is not linear up to a constant.
        """
        return linear_operator(self, x_shape, slots, dtype)

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Mask (0 or 1) of the outputs that depend on valid inputs only; `mask` has the shape of `x`."""
        return mask

    def to_pixels(self, x: Tensor) -> Tensor:
        """Samples of the input at pixel centres; differs from `x` if this holds spline coefficients."""
        return x

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """A small instance with input and slots (float64): the test-suite collects it from the registry."""
        raise NotImplementedError

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


@torch.no_grad()
def linear_operator(
    operator: Operator, x_shape: Shape, slots: dict[str, Tensor], dtype: torch.dtype
) -> LinearOperator:
    """See `Operator.as_linear_operator`."""
    from scipy.sparse.linalg import LinearOperator

    if not operator.affine:
        raise ValueError(f"{type(operator).__name__.lower()} is not linear, nor linear up to a constant")
    device = next((each.device for each in slots.values()), torch.device("cpu"))
    slots = {name: value.to(dtype) for name, value in slots.items()}
    at_zero = operator(torch.zeros(x_shape, dtype=dtype, device=device), **slots)

    def tensor(vector: np.ndarray[Any, Any], shape: Shape) -> Tensor:
        return torch.as_tensor(vector, dtype=dtype, device=device).reshape(shape)

    @torch.no_grad()
    def forward(x: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return (operator(tensor(x, x_shape), **slots) - at_zero).flatten().cpu().numpy()

    def adjoint(y: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        return operator.adjoint(tensor(y, tuple(at_zero.shape)), x_shape, **slots).flatten().cpu().numpy()

    return LinearOperator(
        (at_zero.numel(), math.prod(x_shape)),
        matvec=forward,
        rmatvec=adjoint,
        dtype=at_zero.cpu().numpy().dtype,
    )


@functools.lru_cache(maxsize=16)
def _weights(path: Trajectory, n_frames: int) -> Tensor:
    """Interpolation weights, (instants, N)."""
    if n_frames == 1:
        return torch.ones(path.count(1), 1, dtype=torch.float64)
    from scipy.interpolate import CubicSpline  # most runs need none

    at = (np.arange(path.count(n_frames)) - path.n_before) / path.steps
    return torch.from_numpy(CubicSpline(np.arange(n_frames), np.eye(n_frames))(at))
