"""The result of a solved problem: values in the gauge, with their uncertainty."""

from __future__ import annotations

import math

import numpy as np
import torch

from deepir.arrays.statistics import median_sigma
from deepir.burst import Burst
from deepir.effects.outliers import observed
from deepir.effects.saturation import bounded, clipping_message
from deepir.effects.shading import added_flux
from deepir.estimation.prior_weight import uncertainty
from deepir.fields.line_noise import LineNoise
from deepir.fields.sensor_maps import GaussianMap
from deepir.messages import Message
from deepir.operators.motion_models import Geometry, displacements, homographies
from deepir.optim.solve import Solution
from deepir.problem import Problem
from deepir.result import Array, Result, neutral, to_gauge

REPORTED_PATTERN_COST = 2.0  # dB that the unknown pattern costs the scene


@torch.no_grad()
def make_result(
    problem: Problem,
    geometry: Geometry,
    solution: Solution,
    burst: Burst,
    used: np.ndarray,
    taken: np.ndarray,
    messages: list[str],
    cost: float,
) -> Result:
    """The result of frames that are `taken` into the problem, though perhaps not `used` in the fit."""
    values = {name: value.cpu().numpy() for name, value in solution.values.items()}
    scene, clipped = bounded(problem, problem.operator.to_pixels(solution.values["scene"]))
    result = neutral(geometry.crop(scene.cpu().numpy()), len(used), burst.size, burst.bad_pixels)
    for slot, name in problem.slots.items():
        value, kind = values[name], slot.rpartition(".")[2]
        if kind in ("gain", "offset"):
            setattr(result, kind, value[0, 0].astype(np.float64))
        elif kind == "level":
            result.level[taken] = value.mean((1, 2, 3))
        elif kind == "motion":
            result.motion[taken] = homographies(solution.values[name]).cpu().numpy()
            result.motion[~taken] = np.nan
            if value.ndim == 4:
                flow = displacements(solution.values[name]).cpu().numpy()
                result.extra["flow"] = np.full((len(used), *flow.shape[1:]), np.nan, np.float32)
                result.extra["flow"][taken] = flow
        else:
            result.extra[name] = value.squeeze()
    where = geometry.crop(clipped.cpu().numpy())
    if where.any():
        result.extra["clipped"] = where
    if problem.moving.any():
        result.extra["moving"] = np.zeros((len(used), *burst.size), bool)
        result.extra["moving"][taken] = problem.moving[:, 0].cpu().numpy()
    messages = messages + clipping_message(problem, where, burst.frames[taken])
    result.frames_used, result.history, result.messages = used, solution.history, messages
    known = problem.sensor_unknowns().get("gain") not in problem.free()
    to_gauge(result, known_gain=known, flux=added_flux(problem))
    if reference := float(problem.reference):
        result.scene = result.scene + np.float32(reference)
        result.offset = (result.offset - (result.gain - 1) * reference).astype(np.float32)
    maps = uncertainty(problem, 0.0 if math.isnan(cost) else cost)
    result.uncertainty = maps | {"scene": geometry.crop(maps["scene"])}
    if cost > REPORTED_PATTERN_COST:
        result.messages += [
            Message(
                "pattern-cost",
                f"separating the sensor's pattern from the scene costs {cost:.1f} dB of what {len(problem.data)} "
                "frames show of the scene: take more frames, or move further, in x and in y",
            )
        ]
    result.metrics = {
        "iterations": solution.iterations,
        "evaluations": solution.evaluations,
        "stop_reason": solution.reason,
        "noise_sigma": median_sigma(problem.precision),
        "held_out_rmse": solution.held_out,
        "pattern_cost_db": None if math.isnan(cost) else cost,
        "strengths": strengths(problem),
        "parameters": sum(each.numel() for each in problem.fields["scene"].parameters()),
        "reference_level": float(problem.reference),
    }
    return result


def unseen_scene(problem: Problem, geometry: Geometry, burst: Burst) -> Array:
    """Pixels of the scene that no usable sample of the frames shows, bool, (H, W) or (N, H, W)."""
    usable = torch.from_numpy(burst.valid & ~burst.bad_pixels)[:, None].to(problem.data.device)
    unseen: Array = geometry.crop(~observed(problem, usable).cpu().numpy())
    return unseen if not (burst.stretched or usable.all()) else np.zeros_like(unseen)


def mark_unseen(result: Result, unseen: Array) -> Result:
    """The result with the pixels of its scene that no frame shows, and a message on them, if there are any."""
    if unseen.any():
        result.extra["unseen"] = unseen
        result.messages.append(
            Message(
                "unseen-pixels",
                f"{unseen.sum()} pixel(s) of the scene, {unseen.mean():.2%}, are seen by no frame: they go on smoothly "
                "from what is beside them ('unseen' in result.npz)",
            )
        )
    return result


def within(message: str, where: str) -> str:
    """A message with the place that it is of."""
    return message.within(where) if isinstance(message, Message) else f"{where}: {message}"


def strengths(problem: Problem) -> dict[str, float]:
    """What was given or estimated: sigma of each part, weight of each penalty."""
    found = {}
    for name, field in problem.fields.items():
        for path, part in field.named_modules():
            if isinstance(part, GaussianMap | LineNoise):
                own = path.rpartition(".")[2] or type(part).__name__.lower()
                found[f"{name}.{own}.sigma"] = float(part.sigma)
    for name, each in problem.penalties.items():
        for kind, penalty in each.items():
            found[f"{name}.{kind}.weight"] = penalty.typical_weight()
    return found
