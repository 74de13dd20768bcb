"""Drift: the level of whole frames."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.priors.field import Shape
from deepir.priors.strength import Held
from deepir.registry import register


@register("field", "drift")
class Drift(Held):
    """One Gaussian value for each frame, of mean zero; `sigma`, in data units, is found from the burst if not given.

    Without strength it is zero: over a burst that does not drift, a free level would take part of the scene's slope
    away, for a camera that moves over a slope sees its level change. `jumps` are levels that are known, to which it is
    added: no slope makes levels that differ by more than a frame's pattern does.
    """

    jumps: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        if any(side != 1 for side in shape[1:]):
            raise ValueError(
                f"a drift is one value for each frame, (N, 1, 1, 1), and does not fit {tuple(shape)}"
            )
        super().__init__(shape, neutral, sigma=sigma)
        self.values = nn.Parameter(torch.zeros(self.shape))
        self.register_buffer("jumps", torch.zeros(self.shape))

    def forward(self) -> Tensor:
        """The levels, (N, 1, 1, 1)."""
        return self.neutral + self.jumps + self.levels

    @property
    def levels(self) -> Tensor:
        """What is added to the known jumps, of mean zero."""
        levels = self.step * (self.sigma > 0) * self.values
        return levels - levels.mean()

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the levels over, less their mean."""
        value = value.to(self.values).expand(self.shape) - self.neutral - self.jumps
        self.values.copy_((value - value.mean()) / self.step)

    def penalty(self) -> Tensor | None:
        """`½ Σ level² / sigma²`."""
        return (self.levels / self.sigma).square().sum() / 2 if self.sigma > 0 else None

    @classmethod
    def example(cls) -> Drift:
        """The levels of three frames."""
        return cls((3, 1, 1, 1), sigma=0.5)
