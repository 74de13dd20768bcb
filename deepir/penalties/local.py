"""What penalties that vary from place to place have in common."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.penalties.penalty import Penalty
from deepir.priors.field import Shape


class Local(Penalty):
    """A sum over places. Of a value whose `shape` is given, `share` is how much each counts, (H, W); one at first."""

    #: Whether the weight may follow the scene from place to place.
    follows: ClassVar[bool] = True
    share: Tensor

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None) -> None:
        super().__init__(weight=weight)
        self.register_buffer("share", torch.ones(shape[-2:] if shape else ()))

    def typical(self) -> float:
        """The geometric mean of the places' weights."""
        return float(self.weight * self.share.log().mean().exp())
