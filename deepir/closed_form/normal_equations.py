"""Weighted least squares for gain and offset of each pixel, and their normal equations."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from deepir.closed_form.conjugate_gradient import conjugate_gradient
from deepir.kernels import run
from deepir.kernels.threads import is_compiled

Pair = tuple[Tensor, Tensor]

TOLERANCE = 1e-12  # relative residual at which conjugate gradients stop
MAX_ITERATIONS = 200  # most iterations of conjugate gradients
#: Prior standard deviation of lines relative to that of pixels up to which the system is stored in float32: its
#: condition number grows with the square, and the rounding error is then some 1e-5 of the standard deviation.
MAX_LINE_SIGMA_RATIO = 30
FLOAT32_TOLERANCE = 1e-9  # relative residual at which conjugate gradients stop if the system is in float32


def weighted_least_squares(prediction: Tensor, data: Tensor, precision: Tensor) -> Tensor:
    """`½ Σ w r²`, a float64 scalar with a gradient in the prediction."""
    one = data.new_ones(())
    level = data.new_zeros(len(data), 1, 1, 1)
    return sensor_least_squares(prediction.expand_as(data), data, precision, (one, 0 * one, level))


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
        # Upstream is one, mostly, and a pass over the frames is saved.
        scaled = ctx.saved_tensors if upstream == 1 else [upstream.to(each) * each for each in ctx.saved_tensors]
        gradient, level_gradient = scaled
        return gradient, None, None, None, None, level_gradient, None, None, None


def gradient_and_loss(prediction: Tensor, data: Tensor, precision: Tensor) -> tuple[Tensor, Tensor]:
    """Gradient `w r` in the prediction, and loss `½ Σ w r²`, a float64 scalar."""
    residual = prediction - data
    gradient = precision * residual
    return gradient, residual.mul_(gradient).sum(dtype=torch.float64) / 2


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
    flux, data, precision, gain, offset, level, variances, system = given
    frames = [each.contiguous().flatten(1, -2) for each in (flux, data, precision)]
    maps = (each.expand(1, *flux.shape[1:]).contiguous().flatten(0, -2) for each in (gain, offset))
    gradient = torch.empty_like(frames[0])
    loss, level_gradient = frames[0].new_empty(2, *gradient.shape[:2], dtype=torch.float64)
    run(
        "normal_equations.sensor_weighted_residuals",
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


class PixelEquations:
    """Reduced normal equations of gain and offset at each pixel, pixel parts eliminated.

    Attributes:
        maps: (5, h, w), float64: system (aa, ab, bb) and right-hand side (gain, offset).
        column_sums: Sums of the maps over each column, (5, w).
        row_sums: Sums of the maps over each row, (5, h).
        log_det: Sum over the pixels of half the log-determinant of `I + A V`, a scalar.

    Args:
        flux: Flux on the detector, (N, h, w).
        data: Frames, same shape.
        precision: Inverse variance of each sample, same shape.
        level: Level of each frame and neutral offset, (N,), float64; subtracted from the data.
        neutral: Neutral gain; its product with the flux is subtracted from the data.
        sigma: Prior standard deviations of the pixel parts (gain, offset), (2,), float64; zero without such a part.
        lines: Prior standard deviations of the stronger of columns and rows (gain, offset), (2,).
    """

    maps: Tensor
    column_sums: Tensor  # (5, w)
    row_sums: Tensor  # (5, h)
    log_det: Tensor

    def __init__(
        self, flux: Tensor, data: Tensor, precision: Tensor, level: Tensor, neutral: float, sigma: Tensor, lines: Tensor
    ) -> None:
        self.sigma, self.dtype = sigma, flux.dtype
        self.rounded = flux.dtype == torch.float32 and bool((lines <= MAX_LINE_SIGMA_RATIO * sigma).all())
        self._reduce(flux, data, precision, level, neutral)

    def _reduce(self, flux: Tensor, data: Tensor, precision: Tensor, level: Tensor, neutral: float) -> None:
        """Summed as `d = z - m`, m the first frame's flux: the determinant, which is the same, does not cancel."""
        u, v = self.sigma.square()
        m, zero = flux[0].double(), flux.new_zeros(flux.shape[1:], dtype=torch.float64)
        aa, ab, bb, sa, sb = (zero.clone() for _ in range(5))
        for z, y, w, less in zip(flux.double(), data, precision.double(), level, strict=True):
            d, rest = z - m, y - neutral * z - less
            wd = w * d
            aa += wd * d
            ab += wd
            bb += w
            sa += wd * rest
            sb += w * rest
        shifted = ab + m * bb
        whole = aa + m * (ab + shifted)
        determinant, cross = aa * bb - ab * ab, sa * bb - sb * ab
        lower = bb + u * determinant
        gain, offset = sa + m * sb + v * cross, sb + u * (sb * aa - sa * ab - m * cross)
        each = (whole + v * determinant, shifted, lower, gain, offset)
        system = 1 + u * whole + v * lower
        self.maps, self.log_det = torch.stack(each) / system, system.log().sum() / 2
        self.column_sums, self.row_sums = self.maps.sum(1), self.maps.sum(2)

    def solve(self, root: Tensor, to_columns: Tensor, to_rows: Tensor, weights: Tensor, rhs: Tensor) -> Tensor:
        """Columns and further terms, (2 w + terms,), with the rows eliminated, by conjugate gradients.

        In coordinates in which the system without the rows is the unit matrix. Of such coordinates (c, t), the columns'
        values are `root' (c - to_columns' t)`, with a root (2, 2, w) for each column, and what the terms amount to in
        the rows is `to_rows' t`, (2 h). `weights`, (3, h), make values of the rows of that.
        """
        width = root.shape[-1]

        def by_rows(x: Tensor, rest: Tensor | float = 0.0) -> Tensor:
            c, terms = x[: 2 * width], x[2 * width :]
            columns = (root * (c - terms @ to_columns).reshape(2, 1, width)).sum(0)
            along = self._multiply(columns[:, None]).sum(2) + (terms @ to_rows).reshape(2, -1) + rest
            rows = multiply_symmetric(weights, along)
            down = (root * self._multiply(rows[..., None]).sum(1)).sum(1).flatten()
            return torch.cat((down, to_rows @ rows.flatten() - to_columns @ down))

        zero = torch.zeros_like(rhs)
        return conjugate_gradient(
            lambda x: x - by_rows(x),
            rhs - by_rows(zero, self.row_sums[3:]),
            zero,
            precondition=lambda r: r,
            tolerance=TOLERANCE,
            max_iterations=MAX_ITERATIONS,
        )

    def back_substitute(self, columns: Tensor, smooth: Pair, weights: Tensor, neutral: Tensor, white: Pair) -> Pair:
        """Set the `white` values of the pixels for values of the columns and of what is `smooth`.

        The latter is in each row the combination (2, h, n) of functions of x, (n, w). Returns the right-hand side that
        is left for each row, (2, h), of which `weights` make its value, and the sum of all parts, (2, h, w), with
        `neutral` added.
        """
        others = columns[:, None] + smooth[0] @ smooth[1]
        errors = self.row_sums[3:] - self._multiply(others).sum(2)
        others = others + multiply_symmetric(weights, errors)[..., None]
        sigma = self.sigma[:, None, None]
        found = sigma * (self.maps[3:] - self._multiply(others))
        for each, into in zip(found, white, strict=True):
            into.copy_(each)
        return errors, (neutral[:, None, None] + others + sigma * found).to(self.dtype)

    def variance(self, i: int) -> Tensor:
        """Posterior variance of the white values of gain (0) or offset (1)."""
        return 1 - self.sigma[i].square() * self.maps[2 if i else 0]

    def information(self) -> Tensor:
        """`A`, (aa, ab, bb): what the data say of each pixel with all else held, (3, h, w)."""
        u, v = self.sigma.square()
        aa, ab, bb = self.maps[:3]
        # R = (1 + A V)^-1 A, so that A = R (1 - V R)^-1.
        p, q, r, s = 1 - u * aa, -u * ab, -v * ab, 1 - v * bb
        return torch.stack((aa * s - ab * r, ab * p - aa * q, bb * p - ab * q)) / (p * s - q * r)

    def _multiply(self, x: Tensor) -> Tensor:
        return multiply_symmetric(self.maps[:3], x)


class PixelEquationsCPU(PixelEquations):
    """The same, each in one pass by a compiled loop."""

    def _reduce(self, flux: Tensor, data: Tensor, precision: Tensor, level: Tensor, neutral: float) -> None:
        from deepir.kernels.normal_equations import ROWS_PER_BAND

        (_, height, width), u, v = flux.shape, *self.sigma.square().tolist()
        self.bands = -(-height // ROWS_PER_BAND)
        self.maps = torch.empty(5, height, width, dtype=torch.float64)
        self.row_sums = torch.empty(5, height, dtype=torch.float64)
        down = torch.empty(self.bands, 5, width, dtype=torch.float64)
        nats = torch.empty(self.bands, dtype=torch.float64)
        frames = (each.contiguous() for each in (flux, data, precision))
        run("normal_equations.reduce", self.bands, *frames, level, neutral, u, v, self.maps, self.row_sums, down, nats)
        self.column_sums, self.log_det = down.sum(0), nats.sum()

    def solve(self, root: Tensor, to_columns: Tensor, to_rows: Tensor, weights: Tensor, rhs: Tensor) -> Tensor:
        """See `PixelEquations`."""
        x, maps, tolerance = rhs.clone(), self.maps[:3], TOLERANCE
        if self.rounded:
            maps, tolerance = maps.float(), FLOAT32_TOLERANCE
        system = (maps, root, to_columns, to_rows, weights, self.row_sums[3:].flatten())
        run("normal_equations.solve", 1, *system, tolerance, MAX_ITERATIONS, x)
        return x

    def back_substitute(self, columns: Tensor, smooth: Pair, weights: Tensor, neutral: Tensor, white: Pair) -> Pair:
        """See `PixelEquations`."""
        errors = torch.empty_like(self.row_sums[3:])
        values = torch.empty_like(self.maps[3:], dtype=self.dtype)
        given = (columns.contiguous(), self.row_sums[3:], weights, *(each.contiguous() for each in smooth))
        found = (errors, *white, values)
        run("normal_equations.back_substitute", self.bands, self.maps, *given, self.sigma, neutral, *found)
        return errors, values


def multiply_symmetric(block: Tensor, x: Tensor) -> Tensor:
    """Symmetric 2 x 2 matrices (aa, ab, bb), (3, ...), times (2, ...)."""
    aa, ab, bb = block
    return torch.stack((aa * x[0] + ab * x[1], ab * x[0] + bb * x[1]))
