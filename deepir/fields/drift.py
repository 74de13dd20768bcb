"""Drift: the level of whole frames."""

from __future__ import annotations

import functools
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.fields.base import GaussianField, Shape
from deepir.registry import register

#: Standard deviation of a step of the random walk, relative to that of the common trend per frame.
WALK_SIGMA_RATIO = 1 / 8


@functools.lru_cache(maxsize=8)
def level_basis(count: int, device: torch.device) -> Tensor:
    """Basis of the levels: a linear trend, then the steps of a random walk, each of zero mean.

    A camera that warms up drifts in one direction for a while; independent levels would be penalised in each frame.

    Args:
        count: Number of frames N.
        device: Of the result.

    Returns:
        (N, N), frames by unknowns, float64.
    """
    after = torch.ones(count, count, dtype=torch.float64, device=device).tril()
    after[:, 1:] *= WALK_SIGMA_RATIO
    after[:, 0] = torch.arange(count)
    return after - after.mean(0)


@register("field", "drift")
class Drift(GaussianField):
    """Level of each frame, (N, 1, 1, 1), of zero mean: a linear trend and a random walk, both Gaussian.

    With `sigma` zero the field is zero: a camera that moves over a slope of the scene sees its level change, so a
    free level would absorb part of that slope. `level_offsets` are known levels, which are added: differences
    larger than those of the pattern of a frame cannot come from a slope.

    Args:
        shape: (N, 1, 1, 1).
        neutral: Level that leaves the data unchanged.
        sigma: Prior standard deviation of the change from frame to frame, data units; estimated if None. A step of
            the random walk has `WALK_SIGMA_RATIO` times this.

    Raises:
        ValueError: `shape` is not one value for each frame.
    """

    example_shape = (3, 1, 1, 1)
    example_options: ClassVar = {"sigma": 0.5}
    level_offsets: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        if any(side != 1 for side in shape[1:]):
            raise ValueError(f"a drift is one value for each frame, (N, 1, 1, 1), and does not fit {tuple(shape)}")
        super().__init__(shape, neutral, sigma=sigma)
        self.values = nn.Parameter(torch.zeros(self.shape))
        self.register_buffer("level_offsets", torch.zeros(self.shape))

    def forward(self) -> Tensor:
        """The levels, (N, 1, 1, 1)."""
        return self.neutral + self.level_offsets + self.levels

    @property
    def levels(self) -> Tensor:
        """Deviation from the known level offsets, of zero mean, (N, 1, 1, 1)."""
        made = level_basis(len(self.values), self.values.device).to(self.values)
        return torch.tensordot(made, self.preconditioning_scale * (self.sigma > 0) * self.values, 1)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent the levels less their mean."""
        value = value.to(self.values).expand(self.shape) - self.neutral - self.level_offsets
        back = torch.linalg.pinv(level_basis(len(value), value.device)).to(value)
        self.values.copy_(torch.tensordot(back, value - value.mean(), 1) / self.preconditioning_scale)
