"""How the objective curves along the waves of a scene: what L-BFGS starts from in place of the identity.

A camera that moves by `d` px sees a wave of `k` radians a px change by about `k d` of itself, and only what changes
tells the scene from the sensor: along slow waves the objective is so flat that L-BFGS alone takes hundreds of
iterations. With a free pattern of variance V at each pixel, the curvature along a wave is that of `n` frames less what
they share,

    w (n - |Σ_j exp(i k d_j)|² / (n + 1 / (w V))),

less by the spline that the warp samples, and more by the penalties. Waves longer than the frame, which a Fourier
transform does not have, and the levels of the frames, which look like slopes to a camera that moves, are taken together
in a small dense system.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from deepir.elimination import COLUMN, PIXEL, ROW
from deepir.operators import Sensor, Warp
from deepir.operators.warp import coords
from deepir.penalties.penalty import squared_gradient
from deepir.priors.drift import Drift
from deepir.priors.motion import Motion
from deepir.priors.pixels import Pixels
from deepir.priors.shading import Shading
from deepir.problem import Problem

POINTS = 40  # along each axis, where the frames are sampled for the dense system
PLACES = 5  # along each axis, at which the motion is taken
PEDESTAL = 4.0  # least ratio of the data's level to their spread
RIDGE = 1e-4  # least curvature that is known, as a share of the mean
#: Least curvature along a wave that is made use of, as a share of the mean. Waves that the motion leaves open are not
#: to run to where a weak prior has its optimum: pattern in the scene.
FLOOR = 0.3


class Curvature:
    """An approximate inverse Hessian for some parameters of a problem, the scene's pixels among them."""

    def __init__(
        self, problem: Problem, parameters: Sequence[nn.Parameter], eliminated: Collection[str]
    ) -> None:
        fields = {id(p): field for field in problem.fields.values() for p in field.parameters()}
        mine = [fields[id(p)] for p in parameters]
        self.sizes = [p.numel() for p in parameters]
        self.scene = next(i for i, field in enumerate(mine) if field is problem.fields["scene"])
        self.drift = next((i for i, f in enumerate(mine) if isinstance(f, Drift) and f.sigma > 0), None)
        self.basis = Shading(tuple(parameters[self.scene].shape)).to(problem.data.device)
        drift = next((f for f in mine if isinstance(f, Drift) and f.sigma > 0), None)
        self.tensors = _tensors(problem, mine, self.basis, drift, eliminated)

    @torch.no_grad()
    def solve(self, slope: Tensor) -> Tensor:
        """The approximate inverse Hessian times a flat gradient."""
        given = slope.split(self.sizes)
        found = [each * scale for each, scale in zip(given, self.tensors["scales"], strict=True)]
        scene = given[self.scene].reshape(self.basis.shape[-2:])
        waves = torch.fft.irfft2(torch.fft.rfft2(scene) * self.tensors["waves"], s=scene.shape)
        slow = self.basis.sums(scene.double())
        if self.drift is not None:
            slow = torch.cat((slow, given[self.drift].double()))
        slow, levels = (self.tensors["slow"].double() @ slow).tensor_split([len(self.basis.white)])
        found[self.scene] = (waves + self.basis.spread(slow)).to(slope).flatten()
        if self.drift is not None:
            found[self.drift] = levels.to(slope)
        return torch.cat(found)


def curvature(
    problem: Problem, parameters: Sequence[nn.Parameter], eliminated: Collection[str] = ()
) -> Curvature | None:
    """For pixels that a moving sensor sees; None where the parameters or the physics are others."""
    of_fields = {id(p) for field in problem.fields.values() for p in field.parameters()}
    of_scene = {id(p) for p in problem.fields["scene"].parameters()}
    mine = {id(p) for p in parameters}
    known = mine <= of_fields and bool(mine & of_scene)  # a penalty may have unknowns of its own
    return Curvature(problem, parameters, eliminated) if known and modelled(problem) else None


def modelled(problem: Problem) -> bool:
    """Whether the model holds: a moving sensor, whose gain acts on about the same flux everywhere.

    Over a scene that is dark in part a gain is no additive pattern. L-BFGS then went astray along lines' patterns.
    """
    stages = [type(stage) for _, stage in problem.operator.named()]
    if not isinstance(problem.fields["scene"], Pixels) or stages != [Warp, Sensor] or len(problem.data) < 2:
        return False
    level, spread = torch.var_mean(problem.data[problem.precision > 0])[::-1]
    return bool(level.abs() > PEDESTAL * spread.sqrt())


def information(problem: Problem, eliminated: Collection[str]) -> Tensor | None:
    """Curvature along each wave of a real Fourier transform, in units of the scene; None as for `curvature`."""
    if not modelled(problem):
        return None
    values = problem.values()
    motion = values[problem.slots["warp.motion"]].double()
    precision = float(problem.precision[problem.precision > 0].median())
    shared = _shared(problem, eliminated, precision, len(motion), values["scene"].shape[-2:])
    found = _waves(problem, motion, precision, shared.to(motion.device), values["scene"])
    return found.clamp(min=RIDGE * float(found.mean()))


def spline_response(problem: Problem) -> Tensor:
    """Squared response, along each wave, of the spline at the pixels to its coefficients."""
    y, x = _frequencies(problem.fields["scene"].shape[-2:], problem.data.device)
    return ((2 + y.cos()) / 3 * (2 + x.cos()) / 3).square()


@torch.no_grad()
def _tensors(
    problem: Problem,
    fields: Sequence[nn.Module],
    basis: Shading,
    drift: Drift | None,
    eliminated: Collection[str],
) -> dict[str, Tensor]:
    """`waves` (H, W / 2 + 1), inverse curvatures; `slow`, that of polynomials and levels; `scales` of all others."""
    values = problem.values()
    motion = values[problem.slots["warp.motion"]].double()
    scene: Any = problem.fields["scene"]
    unit = float(scene.scale) ** 2
    precision = float(problem.precision[problem.precision > 0].median())
    shared = _shared(problem, eliminated, precision, len(motion), scene.values.shape[-2:])
    waves = unit * _waves(problem, motion, precision, shared.to(motion.device), values["scene"])
    waves = waves.clamp(min=FLOOR * float(waves.mean()))
    waves[0, 0] = waves.mean()  # the level, which no burst shows, is to stay where it is
    slopes = float(squared_gradient(problem.operator.image(values["scene"])).mean()) / 2
    scales = []
    for field in fields:
        pixels = precision * problem.data[0].numel()
        known = field.step**2 * pixels * slopes if isinstance(field, Motion) else 0.0
        scales.append(1 / known if known > 0 else float((1 / waves).mean()))
    slow = _slow(problem, motion, precision, basis, drift)
    if not eliminated:
        slow = torch.zeros_like(slow)
    return {"waves": (1 / waves).to(scene.values), "slow": slow, "scales": torch.tensor(scales)}


def _variances(problem: Problem, eliminated: Collection[str]) -> dict[tuple[int, ...], float]:
    """Variance of the free pattern in the data's units, by the axes along which it is constant."""
    level = float(problem.data[problem.precision > 0].mean())
    found = {PIXEL: 0.0, COLUMN: 0.0, ROW: 0.0}
    for slot, unit in (("sensor.gain", level), ("sensor.offset", 1.0)):
        name = problem.slots[slot]
        for part in problem.fields[name].parts() if name in eliminated else ():
            if not isinstance(part, Shading):
                found[part.along] += (float(part.sigma) * unit) ** 2
    return found


def _shared(
    problem: Problem, eliminated: Collection[str], precision: float, count: int, size: Sequence[int]
) -> Tensor:
    """`n + 1 / (w V)` for each wave: a pattern constant along columns is all in the waves that are so, too."""
    variance = _variances(problem, eliminated)
    height, width = size
    each = torch.full((height, width // 2 + 1), variance[PIXEL], dtype=torch.float64)
    # In part also in their neighbours: the camera moves over them.
    y, x = height * torch.fft.fftfreq(height), torch.arange(width // 2 + 1)
    each += height * variance[COLUMN] / (math.pi * (1 + y.double().square()))[:, None]
    each += width * variance[ROW] / (math.pi * (1 + x.double().square()))
    return count + 1 / (precision * each).clamp(min=1e-9)


def _waves(problem: Problem, motion: Tensor, precision: float, shared: Tensor, scene: Tensor) -> Tensor:
    """Curvature along each wave of a real Fourier transform, in units of the scene."""
    y, x = _frequencies(scene.shape[-2:], motion.device)
    common = _common(motion, problem.data.shape[-2:], y, x)
    data = precision * spline_response(problem) * (len(motion) - common / shared)
    penalties = problem.penalties["scene"].values() if "scene" in problem.penalties else ()
    stiffness = [penalty.stiffness(scene) for penalty in penalties]
    of_value, of_gradient = (sum(each) for each in zip((0.0, 0.0), *stiffness, strict=True))
    return data + of_value + of_gradient * (4 - 2 * x.cos() - 2 * y.cos())


def _common(motion: Tensor, size: Sequence[int], y: Tensor, x: Tensor) -> Tensor:
    """`|Σ_j exp(i k d_j)|²`, the mean over the frame: where the camera turns, d differs from place to place."""
    total = torch.zeros((), dtype=y.dtype, device=y.device)
    parts = torch.linspace(-0.4, 0.4, PLACES, dtype=y.dtype, device=y.device)
    for at in torch.cartesian_prod(parts * size[1], parts * size[0]):
        moved = motion @ torch.cat((at, at.new_ones(1)))
        shift = moved[:, :2] / moved[:, 2:] - at
        phases = (y * shift[:, 1], x * shift[:, :1])  # (H, N) and (N, W / 2 + 1)
        along_y, along_x = (torch.polar(torch.ones_like(each), each) for each in phases)
        total = total + (along_y @ along_x).abs().square()
    return total / PLACES**2


def _frequencies(size: Sequence[int], device: torch.device) -> tuple[Tensor, Tensor]:
    """Of the waves of a real Fourier transform, radians a px: (H, 1) and (W / 2 + 1,)."""
    height, width = size
    y = 2 * math.pi * torch.fft.fftfreq(height, dtype=torch.float64, device=device)[:, None]
    return y, 2 * math.pi * torch.fft.rfftfreq(width, dtype=torch.float64, device=device)


def _slow(problem: Problem, motion: Tensor, precision: float, basis: Shading, drift: Drift | None) -> Tensor:
    """Inverse of the dense system of the scene's polynomials and, if they drift, the frames' levels."""
    warp: Any = problem.operator.named()[0][1]
    scene: Any = problem.fields["scene"]
    height, width = warp.size
    stride = max(height // POINTS, 1), max(width // POINTS, 1)
    points = coords(warp.place @ motion, warp.size)[:, :: stride[0], :: stride[1]].flatten(1, 2)
    seen = basis.at(points[..., 1], points[..., 0]) * float(scene.scale)
    if drift is not None:
        levels = torch.eye(len(motion), dtype=seen.dtype, device=seen.device) - 1 / len(motion)
        levels = float(drift.step) * levels[:, None].expand(-1, seen.shape[1], -1)
        seen = torch.cat((seen, levels), -1)
    weight = precision * height * width / seen.shape[1]
    flat = seen.flatten(0, 1)
    total = seen.sum(0)
    system = weight * (flat.T @ flat - total.T @ total / len(motion))
    system.diagonal().add_(RIDGE * system.diagonal().mean())
    # Of sums of products the last digits depend on where they lie in memory: without them, runs repeat to the bit.
    return torch.linalg.inv(system).float().contiguous()
