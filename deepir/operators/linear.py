"""Linear maps with adjoints, and their algebra: sums, multiples, products, stacks."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

Shape = tuple[int, ...]


class Linear:
    """A linear map between tensors; `Operator.at` gives that of an operator at given slots.

    `A(x)`, `A.H(y)`, `A.N = A.H @ A`, `A + B`, `A - B`, `2 * A`, `A @ B`, `stack(A, B)`.

    Args:
        forward: x -> y.
        adjoint: y -> x, of the shape `in_shape`.
        in_shape: Shape of x, (N or 1, C, H, W); None: any that fits.
        out_shape: Shape of y; None: it follows from that of x.
        name: For `repr`.
    """

    def __init__(
        self,
        forward: Callable[[Tensor], Tensor],
        adjoint: Callable[[Tensor], Tensor],
        in_shape: Shape | None,
        out_shape: Shape | None,
        name: str = "Linear",
    ) -> None:
        self._forward, self._adjoint = forward, adjoint
        self.in_shape, self.out_shape, self.name = in_shape, out_shape, name

    def __call__(self, x: Tensor) -> Tensor:
        """The map of a tensor; `ValueError` if its shape is not `in_shape`."""
        if not _agree(tuple(x.shape), self.in_shape):
            raise ValueError(f"{self!r} does not take a tensor of shape {tuple(x.shape)}")
        return self._forward(x)

    @property
    def H(self) -> Linear:  # noqa: N802 - as in SigPy and mrpro
        """The adjoint."""
        return Linear(self._adjoint, self._forward, self.out_shape, self.in_shape, f"{_term(self.name)}.H")

    @property
    def N(self) -> Linear:  # noqa: N802
        """The normal operator, `H @ self`."""
        return self.H @ self

    def __matmul__(self, other: Linear) -> Linear:
        """`A @ B` applies `B` first."""
        if not _agree(self.in_shape, other.out_shape):
            raise ValueError(f"{self!r} does not follow {other!r}: the shapes differ")
        return Linear(
            lambda x: self(other(x)),
            lambda y: other._adjoint(self._adjoint(y)),
            other.in_shape,
            self.out_shape,
            f"{_term(self.name)} @ {_term(other.name)}",
        )

    def __add__(self, other: Linear) -> Linear:
        """The sum of two maps between tensors of the same shapes."""
        if not (_agree(self.in_shape, other.in_shape) and _agree(self.out_shape, other.out_shape)):
            raise ValueError(f"{self!r} and {other!r} cannot be added: the shapes differ")
        return Linear(
            lambda x: self(x) + other(x),
            lambda y: self._adjoint(y) + other._adjoint(y),
            self.in_shape or other.in_shape,
            self.out_shape or other.out_shape,
            f"{self.name} + {other.name}",
        )

    def __rmul__(self, factor: float) -> Linear:
        """A multiple by a real number."""
        return Linear(
            lambda x: factor * self(x),
            lambda y: factor * self._adjoint(y),
            self.in_shape,
            self.out_shape,
            f"{factor:g} {_term(self.name)}",
        )

    __mul__ = __rmul__

    def __neg__(self) -> Linear:
        return -1 * self

    def __sub__(self, other: Linear) -> Linear:
        return self + -1 * other

    def __repr__(self) -> str:
        return f"{self.name}: {self.in_shape or 'any'} -> {self.out_shape or 'any'}"

    def as_scipy(self, dtype: torch.dtype = torch.float64, device: str = "cpu") -> LinearOperator:
        """`scipy.sparse.linalg.LinearOperator` on flattened arrays; type and device are those of the slots."""
        from scipy.sparse.linalg import LinearOperator

        if self.in_shape is None or self.out_shape is None:
            raise ValueError(f"{self!r} has no shape: give `at` that of the input")

        def flat(apply: Callable[[Tensor], Tensor], shape: Shape) -> Callable[[np.ndarray[Any, Any]], Any]:
            @torch.no_grad()
            def applied(vector: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
                return apply(torch.as_tensor(vector, dtype=dtype, device=device).reshape(shape)).flatten().cpu().numpy()

            return applied

        return LinearOperator(
            (math.prod(self.out_shape), math.prod(self.in_shape)),
            matvec=flat(self._forward, self.in_shape),
            rmatvec=flat(self._adjoint, self.out_shape),
            dtype=torch.zeros((), dtype=dtype).numpy().dtype,
        )


def identity(shape: Shape) -> Linear:
    """The map of each tensor of a shape to itself."""
    return Linear(lambda x: x, lambda y: y, shape, shape, "Identity")


def stack(*maps: Linear) -> Linear:
    """The outputs of maps of one input, one after the other along the frames.

    Args:
        maps: Of one `in_shape`; their outputs differ in the number of frames alone. For outputs of other sizes, as of
            two cameras, add their normal operators and adjoints.

    Raises:
        ValueError: The shapes do not fit.
    """
    first = maps[0]
    shapes = [each.out_shape for each in maps if each.out_shape is not None]
    counts = [shape[0] for shape in shapes]
    if len({shape[1:] for shape in shapes}) != 1 or {each.in_shape for each in maps} != {first.in_shape}:
        raise ValueError(f"cannot be stacked: {'; '.join(map(repr, maps))}; `at` takes the input's shape")

    def adjoint(y: Tensor) -> Tensor:
        parts = zip(maps, y.split(counts), strict=True)
        return torch.stack([each.H(part) for each, part in parts]).sum(0)

    return Linear(
        lambda x: torch.cat([each(x) for each in maps]),
        adjoint,
        first.in_shape,
        (sum(counts), *shapes[0][1:]),
        f"stack({', '.join(each.name for each in maps)})",
    )


def _agree(one: Shape | None, other: Shape | None) -> bool:
    """Whether two shapes are the same as far as they are known."""
    return one is None or other is None or tuple(one) == tuple(other)


def _term(name: str) -> str:
    """A name as a factor of a product: a sum in brackets."""
    return f"({name})" if " + " in name else name
