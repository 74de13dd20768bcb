"""An operator as SciPy's linear operator, which PyLops and others take."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

    from deepir.operators.base import Operator, Shape


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
