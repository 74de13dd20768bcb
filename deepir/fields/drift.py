"""Drift: the level of whole frames."""

from __future__ import annotations

import functools

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape
from deepir.fields.gaussian_field import GaussianField
from deepir.registry import register

#: Standard deviation of a step from one frame to the next, to that of what all steps have in common.
WOBBLE = 1 / 8


@functools.lru_cache(maxsize=8)
def steps(count: int, device: torch.device) -> Tensor:
    """What a steady change, and then each step of a random walk, make of the levels, (frames, unknowns), mean zero.

    A camera warms up or cools down: its level goes one way for a while, and where it goes by chance it stays. Levels
    that were independent would have to pay for each frame.
    """
    after = torch.ones(count, count, dtype=torch.float64, device=device).tril()
    after[:, 1:] *= WOBBLE
    after[:, 0] = torch.arange(count)
    return after - after.mean(0)


@register("field", "drift")
class Drift(GaussianField):
    """One value for each frame, of mean zero: a steady change and a random walk, both Gaussian.

    `sigma`, of the change from frame to frame in data units, is found from the burst if not given; a step of the walk
    has `WOBBLE` of it.

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
        made = steps(len(self.values), self.values.device).to(self.values)
        return torch.tensordot(made, self.step * (self.sigma > 0) * self.values, 1)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take the levels over, less their mean."""
        value = value.to(self.values).expand(self.shape) - self.neutral - self.jumps
        back = torch.linalg.pinv(steps(len(value), value.device)).to(value)
        self.values.copy_(torch.tensordot(back, value - value.mean(), 1) / self.step)

    def penalty(self) -> Tensor | None:
        """`½ Σ step² / sigma²`."""
        return (self.step * self.values / self.sigma).square().sum() / 2 if self.sigma > 0 else None

    @classmethod
    def example(cls) -> Drift:
        """The levels of three frames."""
        return cls((3, 1, 1, 1), sigma=0.5)
