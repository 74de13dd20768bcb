"""Weighted least squares with analytic gradients; one pass over the frames on the CPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from deepir.kernels.dispatch import is_compiled


def weighted_least_squares(prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
    """`½ Σ w r²`, a float64 scalar with a gradient in the prediction."""
    nats: Tensor = _WeightedLeastSquares.apply(prediction, data, precision)
    return nats


def sensor_least_squares(
    flux: Tensor,
    data: Tensor,
    precision: Tensor,
    sensor: tuple[Tensor, Tensor, Tensor],
    log_det: tuple[Tensor, Tensor, Tensor] | None = None,
) -> Tensor:
    """`½ Σ w r²` for the prediction `gain * flux + offset + level`, with gradients in flux and level.

    Args:
        flux: (N, 1, h, w).
        data: Same shape.
        precision: Inverse variance of each sample, same shape.
        sensor: Gain (1, 1, h, w), offset (1, 1, h, w), level (N, 1, 1, 1).
        log_det: Half the log-determinant of the eliminated pixel parts, nats; their prior variances, (2,); and the maps
            (aa, ab) of the reduced system, (2 or more, h, w), for its gradient in the flux.

    Returns:
        A float64 scalar, nats.
    """
    if log_det is None:
        zero = flux.new_zeros((), dtype=torch.float64)
        log_det = (zero, zero.expand(2), zero.expand(2, 1, 1))
    nats: Tensor = _SensorLeastSquares.apply(flux, data, precision, *sensor, *log_det)
    return nats


class _WeightedLeastSquares(torch.autograd.Function):
    """Weighted least squares; the forward pass computes the gradient, which halves the passes over the frames."""

    @staticmethod
    def forward(ctx: Any, *frames: Tensor) -> Tensor:
        compute = gradient_and_loss_cpu if is_compiled(frames[0]) else gradient_and_loss
        gradient, loss = compute(*frames)
        ctx.save_for_backward(gradient)
        return loss

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, None, None]:
        (gradient,) = ctx.saved_tensors
        return _times(upstream, gradient), None, None


class _SensorLeastSquares(torch.autograd.Function):
    """Least squares of the sensor model; the forward pass computes the gradients in flux and level."""

    @staticmethod
    def forward(ctx: Any, *given: Tensor) -> Tensor:
        *terms, log_det, variances, system = given
        compute = sensor_gradients_and_loss_cpu if is_compiled(terms[0]) else sensor_gradients_and_loss
        level = terms[-1]
        if level.numel() > len(level):  # of lines
            terms[1], terms[-1] = terms[1] - level, torch.zeros_like(level[..., :1, :1])
        gradient, level_gradient, loss = compute(*terms, variances, system)
        level_gradient = level_gradient[:, None, :, None].to(level)
        if level.shape[-1] > 1:  # of columns: the sums of rows do not give it
            flux, data, precision, gain, offset, _ = terms
            level_gradient = gradient_and_loss(torch.addcmul(offset, gain, flux), data, precision)[0]
        ctx.save_for_backward(gradient, level_gradient.sum_to_size(level.shape))
        return loss + log_det

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor | None, ...]:
        gradient, level_gradient = (_times(upstream, each) for each in ctx.saved_tensors)
        return gradient, None, None, None, None, level_gradient, None, None, None


def _times(upstream: Tensor, gradient: Tensor) -> Tensor:
    """Product with the upstream gradient, a scalar; if that is one, as mostly, a pass over the frames is saved."""
    return gradient if upstream == 1 else upstream.to(gradient) * gradient


def gradient_and_loss(prediction: Tensor, data: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
    """Gradient `w r` in the prediction, and loss `½ Σ w r²`, a float64 scalar."""
    residual = prediction - data
    gradient = precision * residual
    return gradient, residual.mul_(gradient).sum(dtype=torch.float64) / 2


def gradient_and_loss_cpu(*frames: Tensor) -> tuple[Tensor, Tensor]:
    """`gradient_and_loss` in one pass over the frames, by a compiled loop."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.weighted_least_squares import weighted_residuals

    prediction, data, precision = (each.contiguous() for each in torch.broadcast_tensors(*frames))
    gradient = torch.empty_like(prediction)
    loss = torch.empty(prediction.shape[:-1], dtype=torch.float64).flatten()
    rows = (each.flatten(0, -2) for each in (prediction, data, precision, gradient))
    parallel_for(weighted_residuals, len(loss), *rows, loss)
    return gradient, loss.sum()


def sensor_gradients_and_loss(*given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gradient in the flux, gradient in the level of each frame's rows (N, h), and loss `½ Σ w r²`.

    Args:
        given: Flux, data and precision (N, 1, h, w); gain and offset (1, 1, h, w); level (N, 1, 1, 1); prior variances
            (2,) and reduced system (2 or more, h, w) of the eliminated pixel parts, see `sensor_least_squares`.
    """
    flux, data, precision, gain, offset, level, (u, v), system = given
    gradient, loss = gradient_and_loss(torch.addcmul(offset, gain, flux) + level, data, precision)
    free = ((u - u * u * system[0]) * flux - u * v * system[1]).to(flux)
    return gain * gradient + precision * free, gradient.sum((1, 3), dtype=torch.float64), loss


def sensor_gradients_and_loss_cpu(*given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`sensor_gradients_and_loss` in one pass over the frames, by a compiled loop."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.weighted_least_squares import sensor_weighted_residuals

    flux, data, precision, gain, offset, level, variances, system = given
    frames = [each.contiguous().flatten(1, -2) for each in (flux, data, precision)]
    maps = (each.expand(1, *flux.shape[1:]).contiguous().flatten(0, -2) for each in (gain, offset))
    gradient = torch.empty_like(frames[0])
    loss, level_gradient = frames[0].new_empty(2, *gradient.shape[:2], dtype=torch.float64)
    parallel_for(
        sensor_weighted_residuals,
        gradient.shape[1],
        *frames,
        *maps,
        level.flatten(),
        *variances.tolist(),
        system,
        gradient,
        loss,
        level_gradient,
    )
    return gradient.reshape(flux.shape), level_gradient, loss.sum()
