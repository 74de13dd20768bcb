"""What a penalty is."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
from torch import Tensor, nn


class Penalty(nn.Module):
    """A negative log-prior of a value, in nats: `weight * energy(value)`.

    `weight` is in nats for each unit of the energy; `given` is what the configuration says of it, None for
    `auto`: then a problem sets it, mostly to `natural`.
    """

    weight: Tensor
    #: Whether it is of the picture that the scene shows, not of the scene's array; see `Operator.image`.
    acts_on_pixels: ClassVar[bool] = False
    #: How plain a scene is, in powers of two, from which the penalty may be stronger by as much as it is plainer.
    smooth_scene_threshold: ClassVar[float] = math.inf

    def __init__(self, *, weight: float | None = None) -> None:
        super().__init__()
        if weight is not None and not 0 <= weight < float("inf"):
            raise ValueError(f"weight must be a number of at least 0, not {weight}")
        self.user_weight = weight
        self.register_buffer("weight", torch.tensor(1.0 if weight is None else float(weight)))

    def forward(self, value: Tensor) -> Tensor:
        """`weight * energy(value)`, a scalar."""
        return self.weight * self.energy(value)

    def energy(self, value: Tensor) -> Tensor:
        """The energy of a value (..., H, W), a scalar in the value's units (or their square)."""
        raise NotImplementedError

    def default_weight(self, sigma: float) -> float:
        """The weight that suits a value with noise of this standard deviation, before it is penalised."""
        return 1.0

    def typical_weight(self) -> float:
        """The weight at a usual place."""
        return float(self.weight)

    def adapt(self, value: Tensor, noise: float) -> None:
        """Learn what the penalty needs from the value as it is, with noise of this standard deviation.

        Called between the stages of a solve; it may change buffers, nothing else.
        """

    def mean_curvature(self, value: Tensor) -> tuple[float, float]:
        """About how the penalty curves at `value`: per square of a change, and per squared gradient of one."""
        return 0.0, 0.0

    def fraction_shrunk_to_zero(self, value: Tensor) -> float:
        """The share of a value that the penalty has made flat; NaN if it does not know."""
        return math.nan

    @classmethod
    def example(cls, **options: Any) -> Penalty:
        """One for a value of 7 x 9 px: the test-suite collects it from the registry."""
        return cls(**options)
