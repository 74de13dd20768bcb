"""Joint MAP estimate of scene and sensor under Gaussian priors."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Annotated

import torch
import torch.nn.functional as F
from pydantic import Field
from scipy.optimize import nnls
from torch import Tensor

from deepir.arrays.statistics import sample_noise
from deepir.assembly import build
from deepir.baselines.rival import register_burst, result_of
from deepir.burst import Burst
from deepir.closed_form.conjugate_gradient import conjugate_gradient
from deepir.config import Config
from deepir.errors import ConfigError
from deepir.operators import Chain, Sensor
from deepir.problems.initial_estimate import start_scene
from deepir.registry import register
from deepir.result import Result, to_gauge

GAUSS_NEWTON_STEPS = 3  # steps of the scene, gain and bias eliminated
MAX_CG_ITERATIONS = 60  # iterations of conjugate gradients in each Gauss-Newton step
CG_TOLERANCE = 1e-3  # norm of the preconditioned residual, relative to its start, at which they stop
PRIOR_WIDTH_RATIO = 2.0  # prior deviation of D z over its root mean square, which edges and texture share
#: D: a pixel less the mean of its four neighbours.
HIGH_PASS_KERNEL = torch.tensor([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]], dtype=torch.float64)[None, None]

Positive = Annotated[float, Field(gt=0)]


@register("method", "hardie_droege2007")
def hardie_droege2007(
    burst: Burst,
    config: Config,
    *,
    scene: Positive | None = None,
    gain: Positive | None = None,
    offset: Positive | None = None,
) -> Result:
    """The most probable scene, gain and bias under Gaussian priors, with or without super-resolution.

    The minimum of `|y - g W z - b|^2 / 2 sigma_n^2 + |D z|^2 / 2 sigma_z^2 + |b|^2 / 2 sigma_b^2`, where D subtracts
    the mean of the four neighbours, by conjugate gradients. Here a gain is estimated too: `|g - 1|^2 / 2 sigma_g^2`.
    Deviations that are not given are estimated from the burst. The registration is deepir's.

    Args:
        scene: Standard deviation sigma_z of D z, in the data's units.
        gain: Standard deviation sigma_g of the gain.
        offset: Standard deviation sigma_b of the bias, in the data's units.

    Raises:
        ConfigError: The physics do not end in a sensor.

    Source: R. C. Hardie, D. R. Droege: A MAP estimator for simultaneous superresolution and detector nonuniformity
    correction, EURASIP J. Advances in Signal Processing (2007).
    """
    motion, used, messages = register_burst(burst, config)
    kept = dataclasses.replace(burst, frames=burst.frames[used], valid=burst.valid[used])
    problem, geometry = build(config, kept, None if motion is None else motion[used])
    *optics, (_, last) = problem.operator.named()
    if not isinstance(last, Sensor):
        raise ConfigError("physics: method 'hardie_droege2007' needs the stage 'sensor' last")
    problem = problem.double()
    start_scene(problem)
    with torch.no_grad():
        values, chain = problem.values(), Chain(dict(optics))
        z = values["scene"]
        slots = {slot: values[name] for slot, name in problem.slots.items() if slot.partition(".")[0] in dict(optics)}
        model = Model(
            forward=lambda z: chain(z, **slots),
            adjoint=lambda y: chain.adjoint(y, tuple(z.shape), **slots),
            data=problem.data,
            usable=(problem.precision > 0).double(),
        )
        model.estimate_precisions(z, scene, gain, offset)
        z, iterations = model.solve(z)
        found, bias = model.sensor(model.forward(z))
        y0, y1, x0, x1 = geometry.window
        image = problem.operator.to_pixels(z)[0, 0, y0:y1, x0:x1]
    poses = None if motion is None else values["motion"].numpy()
    result = result_of(burst, image.numpy(), used, poses, iterations=iterations, messages=messages)
    result.gain, result.offset = found[0, 0].numpy(), bias[0, 0].numpy()
    to_gauge(result)
    return result


@dataclasses.dataclass
class Model:
    """`data = g forward(z) + b + noise` where `usable`, all (N, 1, h, w) float64.

    `adjoint` is the adjoint of `forward`.
    """

    forward: Callable[[Tensor], Tensor]
    adjoint: Callable[[Tensor], Tensor]
    data: Tensor
    usable: Tensor
    #: Inverse variances of the noise, of D z, of the gain and of the bias.
    precisions: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)

    def estimate_precisions(
        self, average: Tensor, scene: float | None = None, gain: float | None = None, bias: float | None = None
    ) -> None:
        """Set the precisions from standard deviations of D z, gain and bias, in the data's units.

        Those that are None are estimated from the registered average, on the grid of the scene, and the residuals.
        """
        n = len(self.data)
        noise = max(sample_noise(self.data[:, 0], self.usable[:, 0] > 0), 1e-4 * float(self.data.std()))
        whole = self.usable.amin(0, keepdim=True) > 0
        flux = self.forward(average)
        level, residual = (each.mean(0, keepdim=True)[whole] for each in (flux, self.data - flux))
        # The average holds 1 / n of the pattern itself, and of the noise.
        squares = (residual**2 - noise**2 / n) / (1 - 1 / max(n, 2))
        parts, _ = nnls(torch.stack([level**2, torch.ones_like(level)], 1).numpy(), squares.numpy())
        pattern = max(float(squares.mean()), 1e-6 * noise**2)
        of_gain = gain**2 if gain else max(float(parts[0]), 1e-4 * pattern / float((level**2).mean()))
        of_bias = bias**2 if bias else max(float(parts[1]), 1e-4 * pattern)  # neither is ruled out
        of_scene = scene**2 if scene else PRIOR_WIDTH_RATIO**2 * float((high_pass(average) ** 2).mean())
        self.precisions = (1 / noise**2, 1 / of_scene, 1 / of_gain, 1 / of_bias)

    def solve(self, z: Tensor) -> tuple[Tensor, int]:
        """The most probable scene, by Gauss-Newton steps without gain and bias, and the number of products it took."""
        noise, smooth, _, _ = self.precisions
        products = 0
        for _ in range(GAUSS_NEWTON_STEPS):
            flux = self.forward(z)
            gain, bias = self.sensor(flux)
            residual = self.usable * (self.data - gain * flux - bias)
            slope = noise * self.adjoint(gain * residual) - smooth * high_pass_normal(z)
            weight = noise * self.adjoint(gain**2 * self.usable) + 1.25 * smooth

            def curvature(vector: Tensor, z: Tensor = z, gain: Tensor = gain, flux: Tensor = flux) -> Tensor:
                nonlocal products
                products += 1
                step = vector.view(z.shape)
                moved = self.usable * gain * self.forward(step)
                more, higher = self._ridge(flux, moved)
                moved = self.usable * (moved - more * flux - higher)
                return (noise * self.adjoint(gain * moved) + smooth * high_pass_normal(step)).flatten()

            step = conjugate_gradient(
                curvature,
                slope.flatten(),
                torch.zeros(slope.numel(), dtype=slope.dtype),
                precondition=lambda vector, weight=weight: vector / weight.flatten(),  # type: ignore[misc]
                tolerance=CG_TOLERANCE,
                max_iterations=MAX_CG_ITERATIONS,
            )
            z = z + step.view(z.shape)
        return z, products

    def sensor(self, flux: Tensor) -> tuple[Tensor, Tensor]:
        """The most probable gain and bias (1, 1, h, w), given the flux (N, 1, h, w) on the detector."""
        gain, bias = self._ridge(flux, self.usable * (self.data - flux))
        return 1 + gain, bias

    def _ridge(self, flux: Tensor, target: Tensor) -> tuple[Tensor, Tensor]:
        """Of each pixel, a and b of `target = a flux + b` under the priors of gain and bias."""
        noise, _, of_gain, of_bias = self.precisions
        a11 = (self.usable * flux**2).sum(0, keepdim=True) + of_gain / noise
        a12 = (self.usable * flux).sum(0, keepdim=True)
        a22 = self.usable.sum(0, keepdim=True) + of_bias / noise
        b1, b2 = (flux * target).sum(0, keepdim=True), target.sum(0, keepdim=True)
        determinant = a11 * a22 - a12**2
        return (a22 * b1 - a12 * b2) / determinant, (a11 * b2 - a12 * b1) / determinant


def high_pass(z: Tensor) -> Tensor:
    """D z: pixels less the mean of their four neighbours, without the outermost rows and columns."""
    return F.conv2d(z, HIGH_PASS_KERNEL)


def high_pass_normal(z: Tensor) -> Tensor:
    """D' D z."""
    return F.conv_transpose2d(high_pass(z), HIGH_PASS_KERNEL)
