"""The method `joint`: all unknowns of a problem estimated together."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from deepir.build import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.contest import Contest
from deepir.errors import ConfigError, DataError, nearest
from deepir.geometry import Geometry
from deepir.levels import drift_message
from deepir.noise import typical_noise
from deepir.operators.points import displacements, homographies
from deepir.order import bridge_message, bridged
from deepir.priors.parts import Part
from deepir.problem import Problem
from deepir.problems.definition import Definition
from deepir.registration import register as register_frames
from deepir.registry import components, lookup, register
from deepir.result import Result, neutral, to_gauge
from deepir.slow_strengths import added_flux, shading_message
from deepir.solve import Progress, Solution, Stage, Step, solve
from deepir.strengths import hold_out
from deepir.uncertainty import pattern_cost, uncertainty

#: Motion, in px at the frame's edge, below which a burst counts as still.
STILL = 0.5
#: Range of the motion along an axis, in px, below which its lines are hard to tell from the scene.
LITTLE = 3.0
#: Standard deviation that rounding to whole numbers makes.
ROUNDED = 0.29
#: Cost of the unknown pattern, in dB, from which it is worth a message.
COSTLY = 2.0
#: Side of the windows, in px, whose mean stands for a sample's signal.
AROUND = 5
#: Least variance of a sample, in the usual one, where noise is given: an offset is no light, and low samples are not
#: as sure as they look.
LEAST = 0.3


@register("method", "joint")
def joint(
    burst: Burst,
    config: Config,
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Path | None = None,
) -> Result:
    """Fields for all unknowns, fitted together (the default)."""
    definition: Definition = lookup("problem", config.problem, "problem")()
    motion, used, messages = registered(burst, config, definition)
    taken = used
    if definition.ordered and motion is not None:
        motion, taken = bridged(motion, used)
        messages += bridge_message(used, taken)
    valid = burst.valid & used[:, None, None]
    kept = dataclasses.replace(burst, frames=burst.frames[taken], valid=valid[taken])
    problem, geometry = build(config, kept, None if motion is None else motion[taken])
    problem = problem.to(config.device)
    messages += _given_noise(problem, config)
    given = problem.precision.amax((0, 1)) > 0
    definition.initialise(problem, config.seed)
    _demand_strengths(problem)
    stages = plan(problem, definition, config)
    if config.scene.get("fit") and not problem.held_out.any():
        hold_out(problem, config.seed)
    solution = solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint)
    messages += definition.remarks(problem)
    if config.solver.max_iterations is None:  # a solve cut short leaves more than drift
        messages += drift_message(problem) + shading_message(problem)
    found = given & ~(problem.precision.amax((0, 1)) > 0)
    burst = dataclasses.replace(burst, bad_pixels=burst.bad_pixels | found.cpu().numpy())
    cost = pattern_cost(problem, definition.weak)
    result = _result(problem, geometry, solution, burst, used, taken, messages, cost)
    result.metrics |= definition.figures(problem)
    return result


def registered(
    burst: Burst, config: Config, definition: Definition
) -> tuple[Tensor | None, np.ndarray, list[str]]:
    """Motion (N, 3, 3) of each frame, which frames are used, and messages; no motion if no slot wants it.

    Raises:
        DataError: Too few frames register, or the burst is still and the problem needs motion.
    """
    everything = np.ones(len(burst.frames), bool)
    model = _motion_model(config)
    if model is None or len(burst.frames) == 1:
        return None, everything, []
    ignore = torch.from_numpy(burst.bad_pixels)
    found = register_frames(torch.from_numpy(burst.frames), model=model, ignore=ignore)
    used = found.used.numpy().astype(bool)
    if used.sum() < max(definition.frames, 1):
        raise DataError(
            f"{burst.source}: only {used.sum()} of {len(used)} frames register with each other, "
            f"{definition.frames} are needed; is it one scene? {'; '.join(found.messages)}"
        )
    messages = list(found.messages)
    if definition.motion:
        messages += _demand_motion(found.motion[torch.from_numpy(used)], burst)
    return found.motion, used, messages


def _motion_model(config: Config) -> str | None:
    """The type of the first motion that starts where the frames are registered: each does, unless it says otherwise."""
    for stage in config.physics.values():
        slot = (stage or {}).get("motion")
        settings = slot if isinstance(slot, dict) else {"type": slot}
        kind = settings.get("type")
        model = getattr(components("field").get(str(kind)), "model", None)
        if settings.get("init", "register" if model else None) == "register":
            return str(model or kind)
    return None


def _demand_motion(motion: Tensor, burst: Burst) -> list[str]:
    """A message for each axis along which the burst moves little; `DataError` if it stands still."""
    height, width = burst.size
    corner = torch.tensor([width / 2, height / 2, 1.0], dtype=motion.dtype)
    at = (motion @ corner)[:, :2]
    moved = (at - corner[:2]).abs().amax()
    if moved < STILL:
        raise DataError(
            f"{burst.source}: the frames do not move (at most {float(moved):.2f} px), so the scene and the sensor's "
            "fixed pattern cannot be told apart. Move the camera between frames, by 3 to 10 px in x and in y"
        )
    few = [
        f"the frames move by only {float(span):.1f} px along {axis}: the {lines}' fixed pattern is hard to tell from "
        "the scene. Move the camera between frames, by 3 to 10 px in x and in y"
        for axis, lines, span in zip("xy", ("columns", "rows"), at.amax(0) - at.amin(0), strict=True)
        if span < LITTLE
    ]
    return few or _along_a_line(at)


def _along_a_line(at: Tensor) -> list[str]:
    """A message if the places (N, 2) where the frames look lie on a slanted line."""
    _, _, axes = torch.linalg.svd(at - at.mean(0), full_matrices=False)
    along, beside = (at @ axis for axis in (axes[0], axes[-1]))
    if len(axes) > 1 and beside.max() - beside.min() >= LITTLE / 2:
        return []
    return [
        f"the frames move along one line, by {float(along.max() - along.min()):.1f} px: what is constant along it is "
        "hard to tell from the scene. Move the camera at right angles to it too, by 3 to 10 px"
    ]


def _given_noise(problem: Problem, config: Config) -> list[str]:
    """Take the noise that the configuration gives, if it does; a message where whole counts cannot have so little."""
    if config.noise == "auto":
        return []
    read, photon = config.noise.read**2, 1 / (config.noise.photons or math.inf)
    # Until there is a prediction, the mean of the neighbours: of single samples the low ones would seem the surest.
    signal = avg_pool2d(problem.data, AROUND, stride=1, padding=AROUND // 2, count_include_pad=False)
    variance = read + photon * signal.clamp_(min=0)
    if not variance.min() > 0:
        raise ConfigError("noise: with read = 0 each sample must be positive, or have photons")
    least = LEAST * float(variance.median())
    problem.precision.copy_((problem.precision > 0) / variance.clamp_(min=least))
    problem.noise = read, photon, least
    if variance.max() > ROUNDED**2 / 10 or problem.data.max() <= 1 or (problem.data % 1).any():
        return []
    return [
        f"noise.read is {config.noise.read:g} in units of the data, and rounding to whole counts makes {ROUNDED}: is "
        "the configuration meant for frames in [0, 1]?"
    ]


def _demand_strengths(problem: Problem) -> None:
    """Raise `ConfigError` for a part whose sigma is neither given nor estimated: it would never leave zero."""
    for slot, name in [("scene", "scene"), *problem.slots.items()]:
        if slot.rpartition(".")[2] in ("gain", "offset"):
            continue
        for part in problem.fields[name].modules():
            if isinstance(part, Part) and not part.given and not part.sigma > 0:
                where = slot if slot == "scene" else f"physics.{slot}"
                raise ConfigError(
                    f"{where}: its part '{type(part).__name__.lower()}' needs a sigma, in the unknown's units; "
                    "only those of gain and offset are found from the data"
                )


def plan(problem: Problem, definition: Definition, config: Config) -> list[Stage]:
    """The stages of `solver.plan`, or else the problem's own; `ConfigError` where they do not fit the unknowns."""
    given, cap, contest = (
        config.solver.plan,
        config.solver.max_iterations,
        Contest(problem, config) if config.scene.get("fit") else None,
    )
    if given is None:
        stages, where = definition.plan(problem), f"problem '{config.problem}' (or take problem=generic)"
    else:
        where = "solver.plan"
        stages = [
            Stage(
                s.name,
                tuple(Step(**p.model_dump() | {"group": tuple(p.group)}) for p in s.steps),
                s.iterations,
            )
            for s in given
        ]
    if contest is not None:
        stages = contest.after(stages, definition.weigh)
    for stage in stages:
        _check_groups(problem, stage, f"{where}, stage '{stage.name}'")
    return [
        dataclasses.replace(s, iterations=min(s.iterations, s.iterations if cap is None else cap))
        for s in stages
    ]


def _check_groups(problem: Problem, stage: Stage, where: str) -> None:
    if all(step.method == "eliminate" for step in stage.steps):
        raise ConfigError(f"{where}: a stage needs a step that is not 'eliminate'")
    for step in stage.steps:
        if unknown := set(step.rates) - set(step.group):
            other = unknown.pop()
            raise ConfigError(f"{where}: rates: no '{other}' in the group; {nearest(other, step.group)}")
        for name in step.group:
            if name not in problem.fields:
                raise ConfigError(f"{where}: no unknown '{name}'; {nearest(name, problem.fields)}")
            if step.method == "eliminate" and name not in problem.closed_form():
                raise ConfigError(
                    f"{where}: '{name}' has no closed form; {nearest(name, problem.closed_form())}"
                )


@torch.no_grad()
def _result(
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
    scene = problem.operator.image(solution.values["scene"]).cpu().numpy()
    result = neutral(geometry.crop(scene), len(used), burst.size, burst.bad_pixels)
    for slot, name in problem.slots.items():
        value, kind = values[name], slot.rpartition(".")[2]
        if kind in ("gain", "offset"):
            setattr(result, kind, value[0, 0].astype(np.float64))
        elif kind == "level":
            result.level[taken] = value.ravel()
        elif kind == "motion":
            result.motion[taken] = homographies(solution.values[name]).cpu().numpy()
            result.motion[~taken] = np.nan
            if value.ndim == 4:
                flow = displacements(solution.values[name]).cpu().numpy()
                result.extra["flow"] = np.full((len(used), *flow.shape[1:]), np.nan, np.float32)
                result.extra["flow"][taken] = flow
        else:
            result.extra[name] = value.squeeze()
    result.frames_used, result.history, result.messages = used, solution.history, messages
    gains = [name for slot, name in problem.slots.items() if slot.rpartition(".")[2] == "gain"]
    known = not any(name in problem.free() for name in gains)
    to_gauge(result, known_gain=known, flux=added_flux(problem))
    maps = uncertainty(problem, 0.0 if math.isnan(cost) else cost)
    result.uncertainty = maps | {"scene": geometry.crop(maps["scene"])}
    result.messages += cost_message(cost, len(problem.data))
    result.metrics = {
        "iterations": solution.iterations,
        "evaluations": solution.evaluations,
        "stop_reason": solution.reason,
        "noise_sigma": typical_noise(problem.precision),
        "held_out_rmse": solution.held_out,
        "pattern_cost_db": None if math.isnan(cost) else cost,
        "strengths": strengths(problem),
    }
    return result


def cost_message(cost: float, n_frames: int) -> list[str]:
    """A line if it costs a good part of the frames that they have to tell the pattern from the scene."""
    if not cost > COSTLY:
        return []
    return [
        f"telling the sensor's pattern from the scene costs {cost:.1f} dB of what {n_frames} frames show of the scene: "
        "take more frames, or move further, in x and in y"
    ]


def strengths(problem: Problem) -> dict[str, float]:
    """What was given or estimated: sigma of each part, weight of each penalty."""
    found = {}
    for name, field in problem.fields.items():
        for part in field.parts():
            found[f"{name}.{type(part).__name__.lower()}.sigma"] = float(part.sigma)
    for name, each in problem.penalties.items():
        for kind, penalty in each.items():
            found[f"{name}.{kind}.weight"] = float(penalty.weight)
    return found
