"""Total generalised variation."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from deepir.penalties.penalty import Penalty
from deepir.priors.field import Shape
from deepir.registry import register

SCALE = 1.6  # as for total variation


@register("penalty", "tgv")
class TGV(Penalty):
    """The least, over all slopes w, of `Σ |∇x - w| + ratio |∇w|`: edges and kinks cost, slopes do not.

    (Bredies, Kunisch, Pock 2010, "Total generalized variation", second order, with the symmetrised gradient of w.) The
    slopes are unknowns of the penalty, found along with the value. Rounded as total variation is.
    """

    unit: Tensor

    def __init__(
        self, shape: Shape, *, weight: float | None = None, ratio: float = 1.0, rounding: float = 0.1
    ) -> None:
        super().__init__(weight=weight)
        for name, option in (("ratio", ratio), ("rounding", rounding)):
            if not 0 < option < float("inf"):
                raise ValueError(f"{name} must be a positive number, not {option}")
        self.ratio, self.rounding = ratio, rounding
        #: Along y and x, in the unit: the value's spread, so that they move as its pixels do.
        self.slopes = nn.Parameter(torch.zeros(2, *shape))
        self.register_buffer("unit", torch.tensor(1.0))

    def energy(self, value: Tensor) -> Tensor:
        """`Σ |∇x - w| + ratio |E w|` at the slopes as they are."""
        e = self.rounding / self.weight.clamp(min=1e-12)
        down, right = self.unit * self.slopes
        edges = ((_down(value) - down).square(), (_right(value) - right).square())
        kinks = (_down(down).square(), _right(right).square(), (_right(down) + _down(right)).square() / 2)
        return _length(edges, e) + self.ratio * _length(kinks, e)

    def adapt(self, value: Tensor, noise: float) -> None:
        """Take the spread of the value for the slopes' unit."""
        spread = value.std().clamp(min=1e-30)
        self.slopes.mul_(self.unit / spread)
        self.unit.copy_(spread)

    def natural(self, noise: float) -> float:
        """One nat for a step of `SCALE` standard deviations."""
        return 1 / (SCALE * noise)

    @classmethod
    def example(cls, **options: Any) -> TGV:
        """For a value of 7 x 9 px."""
        return cls((1, 1, 7, 9), **options)


def _down(x: Tensor) -> Tensor:
    return x.diff(dim=-2, append=x[..., -1:, :])


def _right(x: Tensor) -> Tensor:
    return x.diff(dim=-1, append=x[..., :, -1:])


def _length(parts: tuple[Tensor, ...], e: Tensor) -> Tensor:
    """`Σ sqrt(|v|² + e²) - e`, without its cancellation."""
    squared = torch.stack(parts).sum(0)
    return (squared / (torch.sqrt(squared + e.square()) + e)).sum(dtype=torch.float64)
