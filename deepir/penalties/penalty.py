"""What a penalty is."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Penalty(nn.Module):
    """A negative log-prior of a value, in nats: `weight * energy(value)`.

    `weight` is in nats for each unit of the energy. Without it, it is estimated from the burst by the problem
    (or one, where a problem has no estimate).
    """

    weight: Tensor

    def __init__(self, *, weight: float | None = None) -> None:
        super().__init__()
        if weight is not None and not 0 <= weight < float("inf"):
            raise ValueError(f"weight must be a number of at least 0, not {weight}")
        self.given = weight is not None
        self.register_buffer("weight", torch.tensor(1.0 if weight is None else float(weight)))

    def forward(self, value: Tensor) -> Tensor:
        """`weight * energy(value)`, a scalar."""
        return self.weight * self.energy(value)

    def energy(self, value: Tensor) -> Tensor:
        """The energy, a scalar in the value's units (or their square)."""
        raise NotImplementedError
