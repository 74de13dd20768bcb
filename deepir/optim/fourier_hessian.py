"""How the objective curves along the waves of a scene: the model of `deepir.optim.preconditioner`, wave by wave."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence

import torch
from torch import Tensor

from deepir.arrays.noise_level import median_sigma
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.fields.pixels import Pixels
from deepir.operators import Sensor, Warp
from deepir.operators.homography import displacement_at
from deepir.optim.low_order_model import Variances, variances
from deepir.problem import Problem

LINES = 0.15  # standard deviation of lines' gains up to which they are taken for additive
PLACES = 5  # along each axis, at which the motion is taken
RIDGE = 1e-8  # least curvature that is known, as a share of the mean


def has_fourier_model(problem: Problem) -> bool:
    """Whether the model holds: for pixels that a moving sensor sees, through stages that act on single pixels."""
    first, *others = (stage for _, stage in problem.operator.named())
    local = all(stage.pointwise or stage.temporal for stage in others)
    seen = first.moves and local and bool(others) and isinstance(others[-1], Sensor)
    return seen and len(problem.data) > 1 and isinstance(problem.fields["scene"], Pixels)


def variance_spectrum(problem: Problem, eliminated: Collection[str], weak: float = 1.0) -> Tensor | None:
    """Variance along each wave of a real Fourier transform, in units of the scene; None as for `curvature`.

    The mean over the frame: where the camera turns, other waves are open at other places. With `weak` times the
    scene's penalties. Strong lines are left out: where the scene is bright and dark, their gains are told from it.
    """
    if not has_fourier_model(problem):
        return None
    precision = median_sigma(problem.precision) ** -2
    commons = pattern_coupling(problem) if eliminated else (None,)
    found = [
        here.clamp_(min=RIDGE * float(here.mean())).reciprocal_()
        for here in along_waves(problem, precision, additive(problem, eliminated), commons, weak)
    ]
    return sum(found[1:], found[0]) / len(found)


def spline_response(problem: Problem) -> Tensor:
    """Squared response, along each wave, of the spline at the pixels to its coefficients."""
    return _response(*frequencies(problem.fields["scene"].shape[-2:], problem.data.device))


def additive(problem: Problem, eliminated: Collection[str]) -> Variances:
    """Variances of the pattern's parts, without those of lines too strong to be taken for additive."""
    return variances(problem, eliminated, LINES)


def along_waves(
    problem: Problem,
    precision: float,
    pattern: Variances,
    commons: Iterable[Tensor | None],
    weak: float = 1.0,
) -> Iterator[Tensor]:
    """Curvature along each wave of a real Fourier transform, (H, W / 2 + 1), in units of the scene.

    For samples of this `precision`, and each of what the frames may share, see `pattern_coupling`; None without a free
    pattern.
    """
    scene, count = problem.fields["scene"](), len(problem.data)
    y, x = frequencies(scene.shape[-2:], scene.device)
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    stiffness = [penalty.mean_curvature(scene) for penalty in penalties]
    of_value, of_gradient = (weak * sum(each) for each in zip((0.0, 0.0), *stiffness, strict=True))
    share = _shared(pattern, precision, count, scene.shape[-2:], y, x).reciprocal_()
    y, x = y.float(), x.float()
    told = precision * _response(y, x)
    whole = count * told + of_value + of_gradient * (4 - 2 * x.cos() - 2 * y.cos())
    share *= told
    for pattern_coupling in commons:
        yield whole if pattern_coupling is None else torch.addcmul(whole, pattern_coupling, share, value=-1)


def _response(y: Tensor, x: Tensor) -> Tensor:
    return ((2 + y.cos()) / 3 * (2 + x.cos()) / 3).square()


def _shared(
    variance: Variances,
    precision: float,
    count: int,
    size: Sequence[int],
    y: Tensor,
    x: Tensor,
) -> Tensor:
    """`n + 1 / (w V)` for each wave: a pattern constant along columns is all in the waves that are so, too."""
    height, width = size
    # In part also in their neighbours: the camera moves over them.
    columns = height * variance[COLUMN] / (math.pi * (1 + (y * height / (2 * math.pi)).square()))
    rows = width * variance[ROW] / (math.pi * (1 + (x * width / (2 * math.pi)).square()))
    each = (variance[PIXEL] + columns).float() + rows.float()
    return count + 1 / (precision * each).clamp(min=1e-9)


def pattern_coupling(problem: Problem) -> Iterator[Tensor]:
    """`|Σ_j exp(i k d_j)|²` of each wave at places of the frame: where the camera turns, d differs among them."""
    y, x = frequencies(problem.fields["scene"].shape[-2:], problem.data.device)
    motion = problem.field_of(problem.slot(Warp, "motion"))().double()
    height, width = problem.data.shape[-2:]
    parts = torch.linspace(-0.4, 0.4, PLACES, dtype=y.dtype, device=y.device)
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
    """Of the waves of a real Fourier transform, radians a px: (H, 1) and (W / 2 + 1,)."""
    height, width = size
    y = 2 * math.pi * torch.fft.fftfreq(height, dtype=torch.float64, device=device)[:, None]
    return y, 2 * math.pi * torch.fft.rfftfreq(width, dtype=torch.float64, device=device)
