"""What penalties that vary from place to place have in common."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.fields.base import Shape
from deepir.priors.penalties.base import Penalty


class SpatiallyWeighted(Penalty):
    """A sum over places. Of a value whose `shape` is given, `share` is how much each counts, (H, W); one at first."""

    #: Whether the weight may follow the scene from place to place.
    follows: ClassVar[bool] = True
    share: Tensor

    def __init__(self, shape: Shape | None = None, *, weight: float | None = None) -> None:
        super().__init__(weight=weight)
        self.register_buffer("share", torch.ones(shape[-2:] if shape else ()))

    @property
    def free(self) -> bool:
        """Whether `share` is to be found."""
        return self.given is None and self.share.ndim > 0

    @torch.no_grad()
    def go_on_from(self, other: SpatiallyWeighted) -> None:
        """Count places as another penalty of the same value does, where both may."""
        if self.free and self.follows and other.follows:
            self.share.copy_(other.share)

    def typical(self) -> float:
        """The geometric mean of the places' weights."""
        return float(self.weight * self.share.log().mean().exp())
