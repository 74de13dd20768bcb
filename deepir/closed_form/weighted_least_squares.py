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
    """Its gradient is `w r`: half the passes over the frames that autograd makes."""

    @staticmethod
    def forward(ctx: Any, *frames: Tensor) -> Tensor:
        compute = weighted_on_cpu if is_compiled(frames[0]) else weighted
        slope, nats = compute(*frames)
        ctx.save_for_backward(slope)
        return nats

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, None, None]:
        (slope,) = ctx.saved_tensors
        return _times(gradient, slope), None, None


class _SensorLeastSquares(torch.autograd.Function):
    """Its gradients in flux and level are at hand."""

    @staticmethod
    def forward(ctx: Any, *given: Tensor) -> Tensor:
        *terms, nats, variances, system = given
        compute = weighted_sensor_on_cpu if is_compiled(terms[0]) else weighted_sensor
        level = terms[-1]
        if level.numel() > len(level):  # of lines
            terms[1], terms[-1] = terms[1] - level, torch.zeros_like(level[..., :1, :1])
        slope, drift, half = compute(*terms, variances, system)
        drift = drift[:, None, :, None].to(level)
        if level.shape[-1] > 1:  # of columns: the sums of rows do not tell
            flux, data, precision, gain, offset, _ = terms
            drift = weighted(torch.addcmul(offset, gain, flux), data, precision)[0]
        ctx.save_for_backward(slope, drift.sum_to_size(level.shape))
        return half + nats

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
        slope, drift = (_times(gradient, each) for each in ctx.saved_tensors)
        return slope, None, None, None, None, drift, None, None, None


def _times(gradient: Tensor, slope: Tensor) -> Tensor:
    """Their product; mostly the gradient is one, which spares a pass over the frames."""
    return slope if gradient == 1 else gradient.to(slope) * slope


def weighted(prediction: Tensor, data: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
    """`w r` and `½ Σ w r²`."""
    residual = prediction - data
    slope = precision * residual
    return slope, residual.mul_(slope).sum(dtype=torch.float64) / 2


def weighted_on_cpu(*frames: Tensor) -> tuple[Tensor, Tensor]:
    """The same in one pass."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.weighted_least_squares import weighted_residuals

    prediction, data, precision = (each.contiguous() for each in torch.broadcast_tensors(*frames))
    slope = torch.empty_like(prediction)
    nats = torch.empty(prediction.shape[:-1], dtype=torch.float64).flatten()
    rows = (each.flatten(0, -2) for each in (prediction, data, precision, slope))
    parallel_for(weighted_residuals, len(nats), *rows, nats)
    return slope, nats.sum()


def weighted_sensor(*given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Slope in the flux, slope in the level of each frame's rows (N, h), and `½ Σ w r²`."""
    flux, data, precision, gain, offset, level, (u, v), system = given
    slope, half = weighted(torch.addcmul(offset, gain, flux) + level, data, precision)
    free = ((u - u * u * system[0]) * flux - u * v * system[1]).to(flux)
    return gain * slope + precision * free, slope.sum((1, 3), dtype=torch.float64), half


def weighted_sensor_on_cpu(*given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The same in one pass."""
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.weighted_least_squares import sensor_weighted_residuals

    flux, data, precision, gain, offset, level, variances, system = given
    frames = [each.contiguous().flatten(1, -2) for each in (flux, data, precision)]
    maps = (each.expand(1, *flux.shape[1:]).contiguous().flatten(0, -2) for each in (gain, offset))
    slope = torch.empty_like(frames[0])
    half, drift = frames[0].new_empty(2, *slope.shape[:2], dtype=torch.float64)
    parallel_for(
        sensor_weighted_residuals,
        slope.shape[1],
        *frames,
        *maps,
        level.flatten(),
        *variances.tolist(),
        system,
        slope,
        half,
        drift,
    )
    return slope.reshape(flux.shape), drift, half.sum()
