"""Adapters to and from the package deepinv, which is imported only where it is used.

A denoiser of deepinv becomes one of deepir by `deepir.denoisers.packages.unit_range`.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import lookup


def as_physics(operator: Operator, x_shape: Shape, **slots: Tensor) -> Any:
    """The linear part of an operator as deepinv's `LinearPhysics`; the frames of a burst are a batch.

    Args:
        operator: Linear, up to a constant.
        x_shape: Shape of the input, (N or 1, C, H, W).
        slots: Values of the slots; a chain's are given by `**{"warp.motion": motion}`.

    Raises:
        ValueError: It is not linear up to a constant.
    """
    from deepinv.physics import LinearPhysics

    linear = operator.at(x_shape, **slots)

    class Physics(LinearPhysics):
        """An operator of deepir."""

        def A(self, x: Tensor, **_: Any) -> Tensor:  # noqa: N802 - deepinv's own names
            """The linear part."""
            return linear(x)

        def A_adjoint(self, y: Tensor, **_: Any) -> Tensor:  # noqa: N802
            """Its adjoint."""
            return linear.H(y)

    return Physics()


class PhysicsOperator(Operator):
    """A `LinearPhysics` of deepinv as a stage, `y = A x`, from images of `size` (H, W) to those of `out_size` (h, w).

    All samples of the output count.
    """

    def __init__(self, physics: Any, size: tuple[int, int], out_size: tuple[int, int]) -> None:
        super().__init__()
        self.physics, self.size, self.out_size = physics, size, out_size

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, h, w)."""
        return (*x_shape[:2], *self.out_size)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """(H, W)."""
        return self.size

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Apply `A`."""
        found: Tensor = self.physics.A(x)
        return found

    def adjoint(self, y: Tensor, x_shape: Shape, **slots: Tensor) -> Tensor:
        """Apply `A_adjoint`."""
        found: Tensor = self.physics.A_adjoint(y)
        return found

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Ones."""
        return mask.new_ones(self.out_shape(tuple(mask.shape), len(mask)))


def as_denoiser(name: str) -> Any:
    """A denoiser of deepir, by its registered name, as deepinv's `Denoiser`: `model(x, sigma)`."""
    from deepinv.models import Denoiser

    function = lookup("denoiser", name, "denoiser")

    class Model(Denoiser):
        """A denoiser of deepir."""

        def forward(self, x: Tensor, sigma: Any, **_: Any) -> Tensor:
            """Remove noise of standard deviation `sigma`: a number, or one for each image of the batch."""
            each = torch.as_tensor(sigma).flatten().tolist()
            each = each * len(x) if len(each) == 1 else each
            return torch.cat([function(x[k : k + 1], each[k]) for k in range(len(x))])

    return Model()
