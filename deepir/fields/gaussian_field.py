"""What fields have in common that one strength holds near neutral."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepir.fields.base import Field, Shape


class GaussianField(Field):
    """A Gaussian field of few values; `sigma`, in data units, is found from the burst if it is not given.

    Without strength it is neutral.
    """

    sigma: Tensor
    preconditioning_scale: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral)
        if sigma is not None and not (sigma >= 0 and math.isfinite(sigma)):
            raise ValueError(f"sigma must be a number of at least 0, not {sigma}")
        self.sigma_is_fixed = sigma is not None
        self.register_buffer("sigma", torch.tensor(sigma or 0.0))
        #: What a value moves for a step of one: all pixels of a frame feel it, see `Field`.
        self.register_buffer("preconditioning_scale", torch.tensor(1.0))
