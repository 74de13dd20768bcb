"""The Hessian of the scene in the Fourier domain, and its degrees of freedom."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection, Iterable, Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from deepir.arrays.statistics import median_sigma
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.fields.base import Pixels
from deepir.fields.motion import Motion
from deepir.operators.motion_models import displacement_at
from deepir.optim.low_order_model import MIN_CURVATURE_RATIO, Variances, additive_variances, penalty_curvature
from deepir.problem import Problem

N_MOTION_POSITIONS = 5  # positions along each axis of the frame at which the motion is evaluated
#: Weight of the scene's squared gradient under the weak prior, relative to the precision of a frame.
GRADIENT_WEIGHT = 0.001
N_FREQUENCIES = 24  # frequencies along each axis of the spectrum
#: Polynomials in the sub-pixel shift: six times the weights of the four coefficients of a cubic B-spline.
SPLINE_POLYNOMIALS = ((1.0, -3.0, 3.0, -1.0), (4.0, 0.0, -6.0, 3.0), (1.0, 3.0, 3.0, -3.0), (0.0, 0.0, 0.0, 1.0))


def has_fourier_model(problem: Problem) -> bool:
    """Whether the model applies: a scene of pixels, several frames, a warp first, then only stages on single pixels.

    And one channel.
    """
    first, *others = (stage for _, stage in problem.operator.named())
    local = all(stage.pointwise or stage.temporal for stage in others)
    seen = first.moves and local and bool(others) and problem.sensor is not None
    several = len(problem.data) > 1 and problem.data.shape[1] == 1
    return seen and several and isinstance(problem.fields["scene"], Pixels)


def variance_spectrum(problem: Problem, eliminated: Collection[str], penalty_factor: float = 1.0) -> Tensor | None:
    """Posterior variance of each wave of the scene, averaged over positions in the frame.

    Strong line gains are left out: bright and dark parts of the scene separate them from it.

    Args:
        problem: Its current values are the point of expansion.
        eliminated: Unknowns of the sensor that are free; with none the pattern is known.
        penalty_factor: Factor on the scene's penalties.

    Returns:
        (H, W / 2 + 1), in squared units of the scene; None without a Fourier model.
    """
    if not has_fourier_model(problem):
        return None
    precision = median_sigma(problem.precision) ** -2
    couplings = pattern_coupling(problem) if eliminated else (None,)
    found = [
        here.clamp_(min=MIN_CURVATURE_RATIO * float(here.mean())).reciprocal_()
        for here in fourier_curvature(
            problem, precision, additive_variances(problem, eliminated), couplings, penalty_factor
        )
    ]
    return sum(found[1:], found[0]) / len(found)


def spline_response(problem: Problem) -> Tensor:
    """Squared frequency response of the spline at pixel centres to its coefficients, (H, W / 2 + 1)."""
    return _squared_spline_response(*frequencies(problem.fields["scene"].shape[-2:], problem.data.device))


def fourier_curvature(
    problem: Problem,
    precision: float,
    pattern: Variances,
    couplings: Iterable[Tensor | None],
    penalty_factor: float = 1.0,
) -> Iterator[Tensor]:
    """Curvature along each wave of the scene, for each position in the frame.

    Args:
        problem: Its current values are the point of expansion.
        precision: Of a typical sample.
        pattern: Variances of the free pattern.
        couplings: Of `pattern_coupling`, one for each position; None for a known pattern.
        penalty_factor: Factor on the scene's penalties.

    Yields:
        (H, W / 2 + 1), in inverse squared units of the scene.
    """
    scene, count = problem.fields["scene"](), len(problem.data)
    y, x = frequencies(scene.shape[-2:], scene.device)
    of_value, of_gradient = (penalty_factor * each for each in penalty_curvature(problem, scene))
    share = _coupling_denominator(pattern, precision, count, scene.shape[-2:], y, x).reciprocal_()
    y, x = y.float(), x.float()
    information = precision * _squared_spline_response(y, x)
    whole = count * information + of_value + of_gradient * (4 - 2 * x.cos() - 2 * y.cos())
    share *= information
    for coupling in couplings:
        yield whole if coupling is None else torch.addcmul(whole, coupling, share, value=-1)


def _squared_spline_response(y: Tensor, x: Tensor) -> Tensor:
    return ((2 + y.cos()) / 3 * (2 + x.cos()) / 3).square()


def _coupling_denominator(
    variance: Variances, precision: float, count: int, size: Sequence[int], y: Tensor, x: Tensor
) -> Tensor:
    """`n + 1 / (w V)` for each wave; the variance of columns is concentrated on waves that are constant along them."""
    height, width = size
    # In part also in their neighbours: the camera moves over them.
    columns = height * variance[COLUMN] / (math.pi * (1 + (y * height / (2 * math.pi)).square()))
    rows = width * variance[ROW] / (math.pi * (1 + (x * width / (2 * math.pi)).square()))
    each = (variance[PIXEL] + columns).float() + rows.float()
    return count + 1 / (precision * each).clamp(min=1e-9)


def pattern_coupling(problem: Problem) -> Iterator[Tensor]:
    """`|Σ_j exp(i k d_j)|²` of each wave, for each position in the frame: a rotation makes d depend on it."""
    y, x = frequencies(problem.fields["scene"].shape[-2:], problem.data.device)
    motion = problem.fields[problem.motion_unknown()]().double()
    height, width = problem.data.shape[-2:]
    parts = torch.linspace(-0.4, 0.4, N_MOTION_POSITIONS, dtype=y.dtype, device=y.device)
    places = torch.cartesian_prod(parts * width, parts * height)
    shifts = torch.stack([displacement_at(motion, at) for at in places])
    along_y, along_x = y * shifts[:, None, :, 1], shifts[:, :, :1] * x  # (places, ny, N) and (places, N, nx)
    cos, sin = along_y.cos(), along_y.sin()
    in_y = torch.cat((torch.cat((cos, -sin), 2), torch.cat((sin, cos), 2)), 1).float()
    in_x = torch.cat((along_x.cos(), along_x.sin()), 1).float()
    for of_y, of_x in zip(in_y, in_x, strict=True):
        real, imaginary = (of_y @ of_x).chunk(2)
        yield real.square_().addcmul_(imaginary, imaginary)


def frequencies(size: Sequence[int], device: torch.device) -> tuple[Tensor, Tensor]:
    """Frequencies of a real Fourier transform, radians per px: (H, 1) along y and (W / 2 + 1,) along x."""
    height, width = size
    y = 2 * math.pi * torch.fft.fftfreq(height, dtype=torch.float64, device=device)[:, None]
    return y, 2 * math.pi * torch.fft.rfftfreq(width, dtype=torch.float64, device=device)


def is_joint_with_motion(problem: Problem, group: Collection[str]) -> bool:
    """Whether scene and a parametric motion are fitted jointly, with all rows of a frame exposed at once."""
    if not has_fourier_model(problem) or any(stage.temporal for _, stage in problem.operator.named()):
        return False
    motion = problem.motion_unknown()
    return {"scene", motion} <= set(group) and isinstance(problem.fields[motion], Motion)


def degrees_of_freedom(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """Half the effective degrees of freedom of the scene, nats.

    Args:
        motion: (N, 3, 3) homographies, px.
        size: (h, w) of a frame.

    Returns:
        A scalar with a gradient in the motion.
    """
    positions, prior, response = _tables(size, motion.device)
    moved = motion.double() @ positions
    shift = (moved[:, :2] / moved[:, 2:] - positions[:2]).permute(2, 1, 0)  # (positions, x or y, N)
    t = shift - shift.floor()
    square, cube = t * t, t * t * t
    powers = torch.ones_like(t), t, square, cube, square * square, square * cube, cube * cube
    along_x, along_y = (torch.stack(powers, -1) @ response).unbind(1)
    information = along_y.mT @ along_x / len(motion)
    return 0.5 * math.prod(size) * (information / (information + prior)).mean()


@functools.lru_cache(maxsize=8)  # a solve asks at each evaluation
def _tables(size: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Tables that do not depend on the motion.

    Returns:
        Homogeneous positions in the frame, (3, K); weight of the prior on each wave, (N_FREQUENCIES, N_FREQUENCIES);
        squared response of a shifted cubic B-spline to each wave as a polynomial in the shift, (7, N_FREQUENCIES).
    """
    waves = (torch.arange(N_FREQUENCIES, dtype=torch.float64) + 0.5) * (math.pi / N_FREQUENCIES)
    y, x = (side * torch.linspace(-0.4, 0.4, N_MOTION_POSITIONS, dtype=torch.float64) for side in size)
    positions = torch.cartesian_prod(x, y, x.new_ones(1)).T
    prior = GRADIENT_WEIGHT * (4 - 2 * waves.cos() - 2 * waves.cos()[:, None])
    response = waves.new_zeros(7, N_FREQUENCIES)
    for i, j in itertools.product(range(4), repeat=2):
        product = torch.from_numpy(np.convolve(SPLINE_POLYNOMIALS[i], SPLINE_POLYNOMIALS[j])) / 36
        response += product[:, None] * ((i - j) * waves).cos()
    return positions.to(device), prior.to(device), response.to(device)
