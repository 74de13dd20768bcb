"""Dense motion by optical flow; the problem `flow`."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy import ndimage
from torch import Tensor

from deepir.arrays.samples import MAD_TO_SIGMA
from deepir.effects.effect import Effect
from deepir.effects.sensor_pattern import ReferenceLevel
from deepir.errors import ConfigError
from deepir.fields.constant import Constant
from deepir.fields.motion import Flow
from deepir.likelihoods import Huber
from deepir.operators import Chain, Warp
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.optim.solve import solve
from deepir.problem import Problem
from deepir.problems.nuc import NUC
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step

PYRAMID_FACTORS = (8, 4, 2)  # of the coarser pictures
MIN_SIDE = 16  # px, of the shorter side of a coarse picture
CONTROL_POINT_SPACING = 4  # px of each coarse picture
START_WEIGHT = 0.3  # of the displacements' penalty, relative to the flow's own: the start is far off
LEVEL_ITERATIONS = 40  # at each level
REWEIGHTINGS = 3  # at each level


def optical_flow(frames: Tensor, known: Tensor, flow: Flow) -> Tensor:
    """Displacements (N, 2, h, w), x and y in px, beside where a flow starts.

    Each frame begins as the one before it that explains it best has ended, or without displacements: of a camera that
    drives on, the last frames show near things far from where the first does.

    frames: (N, h, w), without the sensor's pattern. known: the same shape, bool, where they show something. All on the
    CPU, in float32.
    """
    height, width = frames.shape[1:]
    factors = [factor for factor in PYRAMID_FACTORS if min(height, width) // factor >= MIN_SIDE]
    coarse = [averaged(frames, known, factor) for factor in factors]
    found = torch.zeros(len(frames), 2, height, width)
    for k in range(1, len(frames)):
        beside = found[:k]
        for factor, (data, seen) in zip(factors, coarse, strict=True):
            beside = _fitted(data[[0, k]], seen[[0, k]], factor, flow, flow.start[[0, k]], beside)
        found[k] = beside[-1]
    return found


def averaged(frames: Tensor, known: Tensor, factor: int) -> tuple[Tensor, Tensor]:
    """Means of the known of `factor` x `factor` px, about the centre; and which are known: those of at least half."""
    top, left = ((side % factor) // 2 for side in frames.shape[1:])
    counts = known[:, top:, left:].to(frames)
    share = F.avg_pool2d(counts, factor)
    mean = F.avg_pool2d(counts * frames[:, top:, left:], factor) / share.clamp(min=1e-6)
    return mean, share > 0.5


def _fitted(data: Tensor, seen: Tensor, factor: int, flow: Flow, start: Tensor, guesses: Tensor) -> Tensor:
    """Displacements (1, 2, h, w) of the second of two frames, from the best of the guesses (M, 2, h, w).

    `data` and `seen`: both frames, `factor` times coarser, and where they are known. `start`: where their flow starts.
    """
    size = (data.shape[1], data.shape[2])
    spacing = max(factor * CONTROL_POINT_SPACING, flow.spacing)
    field = Flow((2,), size=size, ratio=1 / factor, spacing=spacing, weight=START_WEIGHT * float(flow.weight))
    field.start = resized(start.permute(0, 3, 1, 2) / factor, size).permute(0, 2, 3, 1)
    problem = _problem(field, data, seen)

    def misfit(guess: Tensor) -> float:
        field.init_from(field.start + resized(guess[None] / factor, size).permute(0, 2, 3, 1))
        residual = _residual(problem, seen)
        return float(residual.abs().mean()) if len(residual) else math.inf

    best = min(guesses, key=misfit)
    if misfit(best) == math.inf:  # they share nothing
        return best[None]
    least = 1e-4 * float(data[seen].std())  # of pictures without noise

    def weigh(problem: Problem) -> None:
        residual = _residual(problem, seen)
        spread = max(MAD_TO_SIGMA * float(residual.abs().median()) if len(residual) else 0.0, least)
        counts = problem.valid(problem.values()) & seen[:, None]
        problem.precision.copy_(counts * (factor / spread) ** 2)  # a mean stands for factor² px

    step = (Step(("motion",)),)
    solve(problem, [Stage(f"{i}", step, LEVEL_ITERATIONS, prepare=weigh) for i in range(REWEIGHTINGS)])
    with torch.no_grad():
        beside = (field() - field.start).permute(0, 3, 1, 2)[1:]
    return factor * resized(beside, flow.size)


def _problem(field: Flow, data: Tensor, known: Tensor) -> Problem:
    """Two pictures, the first of which is the scene."""
    size = (data.shape[1], data.shape[2])
    first = torch.where(known[0], data[0], data[0][known[0]].median())
    scene = Constant((1, 1, *size))
    spline = ndimage.spline_filter(first.numpy().astype(np.float64), order=3, mode="mirror")
    scene.values.copy_(torch.from_numpy(spline))
    return Problem(
        Chain({"warp": Warp(size, size, (0, 0))}),
        {"scene": scene, "motion": field},
        data[:, None],
        known[:, None].to(data),
        fidelity=Huber(),
    )


@torch.no_grad()
def _residual(problem: Problem, known: Tensor) -> Tensor:
    """What the second picture is above its prediction, where both show something."""
    values = problem.values()
    seen = (problem.valid(values) & known[:, None])[1]
    return (problem.predict(values) - problem.data)[1][seen]


def resized(maps: Tensor, size: Sequence[int]) -> Tensor:
    """Maps (N, C, h, w) of another size, about the same centre."""
    return F.interpolate(maps, size=tuple(size), mode="bilinear", align_corners=False)


@register("problem", "flow")
class DenseMotion(NUC):
    """Scene, sensor and a dense motion: for parallax, and scenes that are not rigid.

    First the sensor, as in `nuc`, at the registered homographies. Frames without its pattern then show how each is
    displaced from the first, and all is estimated anew from there, the displacements together with scene and sensor.
    """

    def initialise(self, problem: Problem, seed: int) -> None:
        """As for `nuc`."""
        self.seed = seed
        super().initialise(problem, seed)

    def plan(self, problem: Problem) -> Schedule:
        """A round at the homographies, three with displacements; then the scene on all samples.

        Raises:
            ConfigError: The motion is no flow, or fixed.
        """
        motion = _name(problem)
        free, eliminate = self.split(problem)
        still = tuple(name for name in free if name != motion)
        short, last = (8, 20) if has_fourier_model(problem) else (25, 35)
        stages = [
            Stage("homography", (Step(still), *eliminate), short),
            Stage("flow 1", (Step(free), *eliminate), 25, prepare=self._displace),
            Stage("flow 2", (Step(free), *eliminate), 25, prepare=self.update),
            Stage("flow 3", (Step(free), *eliminate), 30, prepare=self.update),
            Stage("scene", (Step(("scene",)),), last, prepare=self.finish, use_held_out=True),
        ]
        return Schedule(stages)

    def between_rounds(self) -> list[Effect]:
        """Not those that compare frames at one place: displacements explain what moves by itself."""
        return [effect for effect in self.effects if not effect.compares_frames]

    @torch.no_grad()
    def _displace(self, problem: Problem) -> None:
        """Start again, at displacements that the frames show."""
        values = problem.values()
        gain, offset, level = (values[name] for name in problem.sensor_unknowns().values())
        corrected = (problem.data - offset - level) / gain
        flow: Any = problem.fields[_name(problem)]
        with torch.enable_grad():
            moved = optical_flow(corrected[:, 0].cpu(), (problem.precision[:, 0] > 0).cpu(), copy.deepcopy(flow).cpu())
        for effect in self.effects:
            if isinstance(effect, ReferenceLevel):
                effect.update(problem, settled=False)
        flow.init_from(flow.start + moved.permute(0, 2, 3, 1).to(flow.start))
        for field in (problem.fields[name] for name in problem.closed_form()):
            field.init_from(torch.full(field.shape, field.neutral).to(corrected))
        problem.precision *= problem.valid(problem.values())
        super().initialise(problem, self.seed)


def _name(problem: Problem) -> str:
    """The unknown that is a dense motion and free."""
    found = [name for name in problem.free() if isinstance(problem.fields[name], Flow)]
    if not found and len(problem.data) > 1:
        raise ConfigError(
            "physics.warp.motion: problem 'flow' estimates a dense motion; take physics.warp.motion=flow, not fixed, "
            "or problem=nuc for one motion of the whole frame"
        )
    return found[0] if found else "motion"
