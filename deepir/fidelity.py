"""How a prediction is compared with the data: negative log-likelihoods in nats.

Each is least where the prediction equals the data, and summed in float64: line searches compare values that
differ in the eighth digit.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.registry import register


class Fidelity(nn.Module):
    """`forward(prediction, data, precision)`, all (N, 1, h, w).

    `precision` is 1 / variance of a sample, and zero where it does not count: it may hold anything finite.
    """

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
        nats: Tensor = _HalfSquares.apply(prediction, data, precision)
        return nats

    def of_sensor(
        self,
        flux: Tensor,
        data: Tensor,
        precision: Tensor,
        *,
        gain: Tensor,
        offset: Tensor,
        level: Tensor,
        freedom: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        """The same of `gain * flux + offset + level`, with gain and offset held: in one pass on the CPU.

        `freedom`: what the pixels add that have gain and offset of their own, in nats, and the covariances
        (2, h, w) of which it has its gradient in the flux, `precision * (of gain * flux + with offset)`.
        """
        if freedom is None:
            freedom = (
                flux.new_zeros((), dtype=torch.float64),
                flux.new_zeros(2, *flux.shape[1:], dtype=torch.float64),
            )
        compute = _OfSensorOnCPU if flux.device.type == "cpu" else _OfSensor
        nats: Tensor = compute.apply(flux, data, precision, gain, offset, level, *freedom)
        return nats


class _HalfSquares(torch.autograd.Function):
    """`½ Σ w r²` with the gradient `w r`, which is at hand: half the passes over the frames that autograd makes."""

    @staticmethod
    def forward(ctx: Any, prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
        compute = _half_squares_on_cpu if prediction.device.type == "cpu" else _half_squares
        weighted, nats = compute(prediction, data, precision)
        ctx.save_for_backward(weighted)
        return nats

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, None, None]:
        (weighted,) = ctx.saved_tensors
        return _times(gradient, weighted), None, None


class _OfSensor(torch.autograd.Function):
    """`½ Σ w r²` of a sensor's frames, and its pixels' freedom; the gradients in flux and level are at hand."""

    @staticmethod
    def forward(
        ctx: Any,
        flux: Tensor,
        data: Tensor,
        precision: Tensor,
        gain: Tensor,
        offset: Tensor,
        level: Tensor,
        nats: Tensor,
        covariance: Tensor,
    ) -> Tensor:
        weighted, half = _half_squares(torch.addcmul(offset, gain, flux) + level, data, precision)
        free = torch.addcmul(covariance[1], covariance[0], flux.double()).to(flux)
        drift = weighted.sum((1, 2, 3), dtype=torch.float64).to(level)
        ctx.save_for_backward(gain * weighted + precision * free, drift)
        ctx.level = level.shape
        return half + nats

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        slope, drift = ctx.saved_tensors
        along = _times(gradient, drift.reshape(ctx.level))
        return _times(gradient, slope), None, None, None, None, along, None, None


class _OfSensorOnCPU(_OfSensor):
    """The same in one pass."""

    @staticmethod
    def forward(
        ctx: Any,
        flux: Tensor,
        data: Tensor,
        precision: Tensor,
        gain: Tensor,
        offset: Tensor,
        level: Tensor,
        nats: Tensor,
        covariance: Tensor,
    ) -> Tensor:
        from deepir.loops import spread
        from deepir.loops.half_squares import of_sensor

        maps = (each.expand(1, *flux.shape[1:]).contiguous().flatten(0, -2) for each in (gain, offset))
        frames = [each.contiguous().flatten(0, -2) for each in (flux, data, precision)]
        slope = torch.empty_like(frames[0])
        half, drift = frames[0].new_empty(2, len(slope), dtype=torch.float64)
        free = covariance.flatten(1, -2)
        spread(of_sensor, len(slope), *frames, *maps, free, level.flatten(), slope, half, drift)
        ctx.save_for_backward(slope.reshape(flux.shape), drift.reshape(len(flux), -1).sum(1).to(level))
        ctx.level = level.shape
        return half.sum() + nats


def _times(gradient: Tensor, slope: Tensor) -> Tensor:
    """Their product; mostly the gradient is one, which spares a pass over the frames."""
    return slope if gradient == 1 else gradient.to(slope) * slope


def _half_squares(prediction: Tensor, data: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
    """`w r` and `½ Σ w r²`."""
    residual = prediction - data
    weighted = precision * residual
    return weighted, residual.mul_(weighted).sum(dtype=torch.float64) / 2


def _half_squares_on_cpu(*frames: Tensor) -> tuple[Tensor, Tensor]:
    """The same in one pass."""
    from deepir.loops import spread
    from deepir.loops.half_squares import half_squares

    prediction, data, precision = (each.contiguous() for each in torch.broadcast_tensors(*frames))
    weighted = torch.empty_like(prediction)
    nats = torch.empty(prediction.shape[:-1], dtype=torch.float64).flatten()
    rows = (each.flatten(0, -2) for each in (prediction, data, precision, weighted))
    spread(half_squares, len(nats), *rows, nats)
    return weighted, nats.sum()


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
        if not 0 < threshold < float("inf"):
            raise ValueError(f"threshold must be a positive number, not {threshold}")
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
