"""An unknown as free values on a grid between bounds."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Field, Shape
from deepir.registry import register

#: Nearest that a start comes to a bound, relative to the range, or to the spread of the start where that is infinite.
MARGIN = 0.02


@register("field", "bounded")
class Bounded(Field):
    """One free value for each element, above `low` and, where it is given, below `high`: positive unless given.

    A value is `low + scale softplus(p)`, or `low + (high - low) sigmoid(p)`, of a free parameter p.

    Raises:
        ValueError: A bound is not finite, or `high` is not above `low`.
    """

    scale: Tensor

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, low: float = 0.0, high: float | None = None
    ) -> None:
        super().__init__(shape, neutral)
        if not math.isfinite(low) or (high is not None and not low < high < math.inf):
            raise ValueError(f"low = {low}, high = {high}: finite numbers are needed, and high above low")
        self.low, self.high = low, high
        self.values = nn.Parameter(torch.zeros(self.shape))
        self.register_buffer("scale", torch.tensor(1.0 if high is None else high - low))
        self.init_from(torch.tensor(float(neutral)))

    def forward(self) -> Tensor:
        """The values."""
        rise = F.softplus(self.values) if self.high is None else torch.sigmoid(self.values)
        return self.low + self.scale * rise

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the value over, as near to the bounds as `MARGIN`."""
        value = value.to(self.values).expand(self.shape) - self.low
        if self.high is None:
            spread = value.std() if value.numel() > 1 else value.new_zeros(())
            self.scale.copy_(torch.where(spread > 0, spread, value.abs().mean().clamp(min=1.0)))
        share = (value / self.scale).clamp(min=MARGIN)
        if self.high is None:
            self.values.copy_(share + (-torch.expm1(-share)).log())  # the inverse of softplus
        else:
            self.values.copy_(torch.logit(share.clamp(max=1 - MARGIN)))
