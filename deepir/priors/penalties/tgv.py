"""Total generalised variation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.priors.penalties.tv import SmoothedNorm
from deepir.registry import register


@register("penalty", "tgv")
class TGV(SmoothedNorm):
    """The least, over all slopes w, of `Σ |∇x - w| + ratio |∇w|`: edges and kinks cost, slopes do not.

    (Bredies, Kunisch, Pock 2010, "Total generalized variation", second order, with the symmetrised gradient of w.) The
    slopes are unknowns of the penalty, found along with the value. Rounded as total variation is.
    """

    scale = 1.6  # as for total variation
    adapts = False  # not tested with a weight map
    unit: Tensor

    def __init__(
        self, shape: Shape, *, weight: float | None = None, ratio: float = 1.0, rounding: float = 0.1
    ) -> None:
        super().__init__(shape, weight=weight, rounding=rounding)
        if not 0 < ratio < float("inf"):
            raise ValueError(f"ratio must be a positive number, not {ratio}")
        self.ratio = ratio
        #: Along y and x, in the unit: the value's spread, so that they move as its pixels do.
        self.slopes = nn.Parameter(torch.zeros(2, *shape))
        self.register_buffer("unit", torch.tensor(1.0))

    def energy(self, value: Tensor) -> Tensor:
        """`Σ |∇x - w| + ratio |E w|` at the slopes as they are."""
        down, right = self.unit * self.slopes
        edges = (_down(value) - down).square() + (_right(value) - right).square()
        shear = _right(down) + _down(right)
        kinks = _down(down).square() + _right(right).square() + shear.square() / 2
        return self.smoothed_l1(edges) + self.ratio * self.smoothed_l1(kinks)

    def adapt(self, value: Tensor, noise: float) -> None:
        """Take the spread of the value for the slopes' unit."""
        spread = value.std().clamp(min=1e-30)
        self.slopes.mul_(self.unit / spread)
        self.unit.copy_(spread)

    @classmethod
    def example(cls, **options: Any) -> TGV:
        """For a value of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)


def _down(x: Tensor) -> Tensor:
    return x.diff(dim=-2, append=x[..., -1:, :])


def _right(x: Tensor) -> Tensor:
    return x.diff(dim=-1, append=x[..., :, -1:])
