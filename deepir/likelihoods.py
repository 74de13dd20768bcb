"""Likelihoods: negative log-likelihoods of the data, nats.

Each is minimal where prediction and data agree. Sums are in float64: line searches compare values that differ in the
eighth digit.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.closed_form.normal_equations import weighted_least_squares
from deepir.fields.base import check_positive
from deepir.registry import register

MAX_NEGATIVE_FRACTION = 0.1  # fraction of negative samples from which data cannot be photon counts
CAUCHY_SCALE = 5.0  # residual at which a sample has half its weight (Cauchy weights), noise standard deviations


class Fidelity(nn.Module):
    """Negative log-likelihood `forward(prediction, data, precision)`, all (N, 1, h, w).

    `precision` is the inverse variance of a sample; zero where it does not count and may hold anything finite.
    """

    quadratic = False  # whether it is a sum of squares, as a closed form needs

    def check_data(self, data: Tensor, usable: Tensor) -> None:
        """Raise `ValueError` for usable data that cannot have this noise."""

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """A scalar, in nats."""
        raise NotImplementedError


@register("fidelity", "gaussian")
class Gaussian(Fidelity):
    """Gaussian noise with a variance for each sample: `½ Σ r² / variance`."""

    quadratic = True

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Half the sum of squared, weighted residuals."""
        return weighted_least_squares(prediction, data, precision)


@register("fidelity", "l1")
class L1(Fidelity):
    """Laplacian noise of the same variance: `Σ sqrt(2) |r| / sigma`."""

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """The sum of absolute, weighted residuals."""
        return ((2 * precision).sqrt() * (prediction - data).abs()).sum(dtype=torch.float64)


@register("fidelity", "huber")
class Huber(Fidelity):
    """Gaussian up to `threshold` standard deviations, Laplacian beyond (Huber 1964): for outliers."""

    def __init__(self, *, threshold: float = 1.345) -> None:
        super().__init__()
        check_positive(threshold=threshold)
        self.threshold = threshold

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Huber's function of the weighted residuals."""
        residual = precision.sqrt() * (prediction - data)
        each = F.huber_loss(residual, torch.zeros_like(residual), reduction="none", delta=self.threshold)
        return each.sum(dtype=torch.float64)


@register("fidelity", "poisson")
class Poisson(Fidelity):
    """Photon noise: `Σ t (p - y - y log(p / y))`, half the Poisson deviance of `t y` photons.

    `t`, the photons for each unit of data, is one number for the burst, with which photon noise explains the
    variances: `t = Σ y² / variance / Σ y`. A sample of no photons counts too.
    """

    def check_data(self, data: Tensor, usable: Tensor) -> None:
        """Photons are not negative; a few samples about zero may be, by the noise of the read-out."""
        fraction = float(((data < 0) & usable).sum() / usable.sum())
        if fraction > MAX_NEGATIVE_FRACTION:
            raise ValueError(f"poisson counts photons, but {fraction:.0%} of the data are negative; take gaussian")

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Half the deviance; negative data count as zero."""
        counts = precision > 0
        y = data.clamp(min=0) * counts
        photons = (precision * y.square()).sum(dtype=torch.float64) / y.sum(dtype=torch.float64)
        # Below a tenth of a photon the parabola goes on: finite, convex, and its slope points back up.
        floor = (0.1 / photons).to(y)
        p, below = prediction.clamp(min=floor), (floor - prediction).clamp(min=0)
        deviance = p - y + torch.xlogy(y, y) - y * p.log()
        beyond = (y / floor - 1) * below + (y / floor + 1) * below.square() / (2 * floor)
        return photons * (counts * (deviance + beyond)).sum(dtype=torch.float64)
