"""How a prediction is compared with the data: negative log-likelihoods in nats."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.registry import register


class Fidelity(nn.Module):
    """`forward(prediction, data, precision)`: all (N, 1, h, w); precision is 1 / variance, zero where nothing counts."""

    #: Whether it is the sum of squares that a closed form needs.
    quadratic = False

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """A scalar, in nats."""
        raise NotImplementedError


@register("fidelity", "gaussian")
class Gaussian(Fidelity):
    """Gaussian noise with a variance for each sample: `½ Σ r² / variance`."""

    quadratic = True

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Half the sum of squared, weighted residuals."""
        return (precision * (prediction - data).square()).sum(dtype=torch.float64) / 2


@register("fidelity", "l1")
class L1(Fidelity):
    """Laplacian noise of the same variance: `Σ sqrt(2) |r| / sigma`."""

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """The sum of absolute, weighted residuals."""
        return ((2 * precision).sqrt() * (prediction - data).abs()).sum()


@register("fidelity", "huber")
class Huber(Fidelity):
    """Gaussian up to `threshold` standard deviations, Laplacian beyond (Huber 1964)."""

    def __init__(self, *, threshold: float = 1.345) -> None:
        super().__init__()
        self.threshold = threshold

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Huber's function of the weighted residuals."""
        residual = precision.sqrt() * (prediction - data)
        return torch.nn.functional.huber_loss(
            residual, torch.zeros_like(residual), reduction="sum", delta=self.threshold
        )


@register("fidelity", "poisson")
class Poisson(Fidelity):
    """Photon noise: `Σ t (p - y log p)` with `t = precision * data` photons for each unit of data."""

    def forward(self, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        """Poisson deviance; a prediction that is not positive counts as a very small one."""
        photons = precision * data.clamp(min=0)
        floor = 1e-6 * data.abs().max()
        positive = prediction.clamp(min=floor)
        # The linear continuation below the floor keeps a gradient that points back up.
        below = (floor - prediction).clamp(min=0) * (data.clamp(min=0) / floor)
        log_ratio = (positive / data.clamp(min=floor)).log()
        return (photons * (prediction - data - data.clamp(min=0) * log_ratio + below)).sum()
