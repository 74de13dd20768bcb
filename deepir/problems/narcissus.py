"""The problem `narcissus`: stray flux that the optics reflect onto the sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.arrays.statistics import sample_noise
from deepir.effects.noise import start_precision
from deepir.effects.sensor_pattern import start_parts
from deepir.effects.shading import estimate_low_order, stray_flux_fields
from deepir.errors import ConfigError
from deepir.estimation.prior_weight import weigh_scene
from deepir.estimation.residuals import down_weight_outliers, fixed_pattern_residual
from deepir.fields.basis_expansion import BasisExpansion
from deepir.fields.constant import Constant
from deepir.messages import Message
from deepir.operators import Add, Warp
from deepir.operators.motion_models import PARAMETERS
from deepir.operators.warp import CANVAS_MARGIN
from deepir.optim.objective import hold_out
from deepir.problem import Problem
from deepir.problems.initial_estimate import start_scene
from deepir.problems.nuc import NUC
from deepir.registration import register as register_frames
from deepir.registry import lookup, register
from deepir.schedule import Schedule, Stage, Step

#: Highest spatial frequency of the fit, half waves over the frame: finer structure is more likely the scene's.
MAX_STRAY_FREQUENCY = 6.0
REDUCED_SIDE = 128  # shorter side to which the frame is reduced, px
N_REWEIGHTING_ROUNDS = 50  # rounds of reweighting
ONE_FRAME_MESSAGE = Message(
    "one-frame",
    "one frame: only its smoothness separates stray flux from the scene. A slope or a large glow of "
    "the scene is in it, its own fine parts and the pattern of the pixels are in the scene. Take 5 frames or more "
    "while the camera moves",
)
KNOWN_SENSOR_FACTOR = 3  # times the iterations where the sensor is known: no elimination speeds the stray flux up
SCENE_REPEATS = 3  # of the scene's own stage: its curvature changes as the prior smooths the noise of strong stray flux


@torch.no_grad()
def tv_minimising_fit(frame: Tensor, usable: Tensor, field: BasisExpansion) -> Tensor:
    """Low-order map whose subtraction minimises the total variation of a frame (h, w), by reweighted least squares.

    Edges of the scene have little weight; a slope of the scene is attributed to stray flux. The map is float64, in the
    basis of the field up to `MAX_STRAY_FREQUENCY`.
    """
    one = torch.eye(len(field.values), dtype=frame.dtype, device=frame.device)
    terms = torch.stack([field.synthesise(each) for each in one[field.frequency <= MAX_STRAY_FREQUENCY]])
    side = max(1, min(frame.shape) // REDUCED_SIDE)
    coverage = F.avg_pool2d(usable.double()[None], side)
    maps = F.avg_pool2d(torch.cat((frame[None], terms)).double() * usable, side) / coverage.clamp(min=1e-6)
    known = (coverage > 0.5).double()
    slopes = torch.cat([maps.diff(dim=axis).flatten(1) for axis in (1, 2)], 1)
    valid = torch.cat([known.unfold(axis, 2, 1).amin(-1).flatten() for axis in (1, 2)])
    noise = max(2**0.5 * sample_noise(frame[None], usable[None]) / side, 1e-9 * float(slopes[0].abs().max()))
    found = slopes.new_zeros(len(terms))
    for _ in range(N_REWEIGHTING_ROUNDS):
        left = (slopes[0] - found @ slopes[1:]).abs()
        weighted = slopes[1:] * (valid / left.clamp(min=noise))
        found = torch.linalg.pinv(weighted @ slopes[1:].T, hermitian=True) @ (weighted @ slopes[0])
    return torch.tensordot(found, terms.double(), 1)


@register("problem", "narcissus")
class Narcissus(NUC):
    """Scene, stray flux, gain, offset and motion from a jittered burst: the scene moves, the stray flux stays.

    Stray flux first, with a gain that is taken for even: one that follows at once would explain strong stray flux as a
    sensor that sees no scene. Then as in `nuc`. From one frame, only smoothness separates stray flux from the scene.
    """

    judged = False

    frames = 1
    operators = ("add", "sensor")
    effect_names = (
        *("frame_gain", "frame_offset", "line_noise", "noise", "sensor_pattern", "shading"),
        *("gain_drift", "vignetting"),
    )

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise and patterns of the raw frames; scene: registered average, less the low-order part that stays still."""
        _demand_terms(problem)
        start_precision(problem)
        if len(problem.data) == 1:
            _start_alone(problem)
            self.messages = [ONE_FRAME_MESSAGE]
        start_scene(problem)
        estimate_low_order(problem, start=True)
        rest = fixed_pattern_residual(problem)
        start_parts(problem, rest)
        down_weight_outliers(problem, rest)
        hold_out(problem, seed)
        weigh_scene(problem, self.sensor_weight)

    def plan(self, problem: Problem) -> Schedule:
        """Scene and stray flux; then as in `nuc`."""
        if len(problem.data) == 1:
            return Schedule([Stage("scene", (Step(("scene",)),), 60, prepare=weigh_scene, use_held_out=True)])
        plan = super().plan(problem)
        rounds = [stage for stage in plan if not stage.name.startswith("scene")]
        scenes = [stage for stage in plan if stage.name.startswith("scene")]
        closed = problem.closed_form()
        still = tuple(name for name in problem.free() if name not in {*closed, problem.motion_unknown()})
        offset = problem.sensor_unknowns().get("offset", "")
        steps = (Step(still), Step((offset,), "eliminate")) if offset in closed else (Step(still),)
        stages = [
            Stage("stray 1", steps, 20),
            Stage("stray 2", steps, 20, prepare=_register),
            *(replace(each, prepare=partial(self._prepare, each.prepare)) for each in rounds),
            *(
                replace(scene, name=f"scene {i + 1}", prepare=None if i else self.finish)
                for i in range(SCENE_REPEATS)
                for scene in scenes
            ),
        ]
        return Schedule(
            replace(each, iterations=each.iterations * (1 if closed else KNOWN_SENSOR_FACTOR)) for each in stages
        )

    def _prepare(self, prepare: Callable[[Problem], None] | None, problem: Problem) -> None:
        """A round's own preparation, with the frames registered again first; the first round has none of its own."""
        _register(problem)
        if prepare is not None:
            prepare(problem)
        else:
            estimate_low_order(problem)
            weigh_scene(problem, self.sensor_weight)


@torch.no_grad()
def _register(problem: Problem) -> None:
    """Register the frames again, without stray flux and offset: strong ones, which stand still, draw frames along."""
    values = problem.values()
    dark = problem.predict(values | {"scene": torch.zeros_like(values["scene"])})
    frames, usable = (problem.data - dark)[:, 0], problem.precision[:, 0] > 0
    for name in problem.free():
        field = problem.fields[name]
        model = next((kind for kind in PARAMETERS if type(field) is lookup("field", kind)), None)
        if model is None or not isinstance(first := problem.operator.named()[0][1], Warp):
            continue
        found = register_frames(frames.cpu(), model=model, ignore=~usable.any(0).cpu())
        before = field().double().cpu()
        apart = (found.motion - before)[:, :2, 2].abs().amax()
        if found.used.all() and first.size == frames.shape[1:] and apart < CANVAS_MARGIN:
            field.init_from(found.motion.to(problem.data.device))


def _demand_terms(problem: Problem) -> None:
    """Raise `ConfigError` for stray flux that is neither given nor made of few terms."""
    stages = dict(problem.operator.named())
    for slot, name in problem.slots.items():
        field = problem.fields[name]
        if isinstance(stages[slot.rpartition(".")[0]], Add) and not isinstance(field, BasisExpansion | Constant):
            raise ConfigError(
                f"physics.{slot}: stray flux that is free at each pixel is the offset. Take dct (smooth) or radial, "
                "or a constant"
            )


@torch.no_grad()
def _start_alone(problem: Problem) -> None:
    """Stray flux as the one frame has it."""
    for field in stray_flux_fields(problem):
        frame, usable = problem.data[0, 0], problem.precision[0, 0] > 0
        field.preconditioning_scale.copy_(frame[usable].std() / frame.numel() ** 0.5)
        if not field.sigma_is_fixed:
            field.sigma.copy_(frame[usable].std())
        field.init_from(tv_minimising_fit(frame, usable, field).to(frame))
