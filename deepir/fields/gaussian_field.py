"""Base class of zero-mean Gaussian fields with one standard deviation."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from deepir.fields.base import Field, Shape


class GaussianField(Field):
    """Zero-mean Gaussian deviation from neutral; neutral if `sigma` is zero.

    Args:
        shape: Of the value.
        neutral: Value that leaves the data unchanged.
        sigma: Prior standard deviation, data units; estimated if None.

    Raises:
        ValueError: `sigma` is negative or not finite.
    """

    sigma: Tensor
    preconditioning_scale: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, *, sigma: float | None = None) -> None:
        super().__init__(shape, neutral)
        if sigma is not None and not (sigma >= 0 and math.isfinite(sigma)):
            raise ValueError(f"sigma must be a number of at least 0, not {sigma}")
        self.sigma_is_fixed = sigma is not None
        self.register_buffer("sigma", torch.tensor(sigma or 0.0))
        #: Change of the value per unit of a parameter, see `Field`.
        self.register_buffer("preconditioning_scale", torch.tensor(1.0))
