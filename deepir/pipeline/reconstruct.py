"""The method `joint`: all unknowns of a problem estimated together."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Sequence

import numpy as np
import torch

from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import Config
from deepir.config.components import options_schema, validate
from deepir.diagnostics.fit import doubtful_motion, equalised_message, misfit_message, scene_in_pattern_message
from deepir.effects.bad_pixels import region_message
from deepir.effects.frame_gain import has_exposures
from deepir.errors import ConfigError, DataError
from deepir.estimation.prior_weight import pattern_cost_db
from deepir.fields.sensor_maps import GaussianMap
from deepir.operators.motion_models import homographies
from deepir.optim.objective import Checkpoint, hold_out
from deepir.optim.solve import Progress, Solution, solve
from deepir.pipeline.bursts import solve_data_sets
from deepir.pipeline.collect import make_result, mark_unseen, sampled_uncertainty, unseen_scene
from deepir.pipeline.register import frames_of_burst, motion_messages, register_frames
from deepir.pipeline.safeguard import safeguarded, unregistered
from deepir.pipeline.schedule import (
    given_noise,
    interpolate_missing_motion,
    interpolation_message,
    make_recipe,
    network_message,
    plan,
)
from deepir.problem import Problem
from deepir.problems.recipe import Recipe
from deepir.recording.correct import CorrectedRecording
from deepir.registry import lookup, register
from deepir.result import Result, neutral


@register("method", "joint")
def joint(
    burst: Burst,
    config: Config,
    *,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Checkpoint | None = None,
) -> Result:
    """Fields for all unknowns, fitted together (the default)."""
    if config.datasets:
        return solve_data_sets(burst, config, callbacks=callbacks, checkpoint=checkpoint)
    recipe = make_recipe(config)
    try:
        motion, used, messages = register_frames(burst, config, recipe)
    except DataError as refusal:
        if not recipe.judged:
            raise
        return mark_unseen(unregistered(burst, refusal), ~burst.valid[0])
    taken = used
    if recipe.ordered and motion is not None:
        motion, taken = interpolate_missing_motion(motion, used)
        messages += interpolation_message(used, taken)
    valid = burst.valid & used[:, None, None]
    kept = frames_of_burst(dataclasses.replace(burst, valid=valid), taken)
    problem, geometry = build(config, kept, None if motion is None else motion[taken])
    problem = problem.to(config.device)
    if burst.motion is not None and motion is not None:
        problem.fields[problem.motion_unknown()].requires_grad_(False)
    if burst.stretched:
        messages += equalised_message(np.where(valid, burst.frames, np.nan)[taken])
    messages += given_noise(problem, config)
    given = problem.alive()
    recipe.initialise(problem, config.seed)
    _demand_strengths(problem)
    _demand_scene(problem)
    stages = plan(problem, recipe, config)
    if config.scene.get("fit") and not problem.held_out.any():
        hold_out(problem, config.seed)
    messages += network_message(problem, stages)
    solution = solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint)
    complete = config.solver.max_iterations is None  # a solve cut short leaves more than drift
    picture = scene_in_pattern_message(problem)
    found = given & ~problem.alive()
    messages = _small_motion(problem, recipe) + messages + recipe.warnings(problem, complete=complete) + picture
    messages += (misfit_message(problem, burst.messages) if complete else []) + region_message(found[None, None])
    known = dataclasses.replace(burst, bad_pixels=burst.bad_pixels | found.cpu().numpy())
    cost = pattern_cost_db(problem, recipe.sensor_weight)

    def collect(each: Solution) -> Result:
        return make_result(problem, geometry, each, known, used, taken, list(messages), cost)

    result = collect(solution)
    result.uncertainty |= sampled_uncertainty(problem, stages[-1], config, callbacks, collect)
    result.metrics |= recipe.metrics(problem)
    shown = kept if motion is None else dataclasses.replace(kept, bad_pixels=known.bad_pixels)
    unseen = unseen_scene(problem, geometry, shown)
    if not recipe.judged:
        return mark_unseen(result, unseen)
    doubt = picture
    if burst.motion is None:  # else it was found elsewhere
        doubt = picture or doubtful_motion(problem, burst.frames, burst.valid & ~burst.bad_pixels, used)
    result.messages = list(dict.fromkeys(doubt + result.messages))
    judged = burst if doubt else _evened(known, problem, taken)
    final = safeguarded(result, judged, registered=motion is not None, trusted=not doubt)
    return mark_unseen(final, ~burst.valid[0] if final.frames_used.sum() < used.sum() else unseen)  # of the first frame


def _evened(burst: Burst, problem: Problem, taken: np.ndarray) -> Burst:
    """The burst with the frames that were divided by their exposures."""
    if not has_exposures(problem):
        return burst
    frames = burst.frames.copy()
    frames[taken] = (problem.data + problem.reference)[:, 0].cpu().numpy()
    return dataclasses.replace(burst, frames=frames)


@torch.no_grad()
def _small_motion(problem: Problem, recipe: Recipe) -> list[str]:
    """Messages on a motion, as it was last estimated, that leaves scene and pattern hard to separate."""
    name = problem.motion_unknown()
    if not (recipe.motion and name) or len(problem.data) == 1:
        return []
    motion = homographies(problem.values()[name]).double().cpu()
    return motion_messages(motion, (problem.data.shape[-2], problem.data.shape[-1]))


def _demand_scene(problem: Problem) -> None:
    """Raise `ConfigError` for a prior that draws nothing but one level of data that have more."""
    with torch.no_grad():
        drawn = problem.fields["scene"]()
    if drawn.numel() > 1 and not drawn.std() > 0 and problem.data[problem.precision > 0].std() > 0:
        kind = type(problem.fields["scene"]).__name__.lower()
        raise ConfigError(
            f"scene: '{kind}' draws nothing but one level: give its sigma, in the data's units, if it has one, or take "
            "another prior"
        )


def _demand_strengths(problem: Problem) -> None:
    """Raise `ConfigError` for a part whose sigma is neither given nor estimated: it would never leave zero."""
    for slot, name in [("scene", "scene"), *problem.slots.items()]:
        if slot.rpartition(".")[2] in ("gain", "offset"):
            continue
        for part in problem.fields[name].modules():
            if isinstance(part, GaussianMap) and not part.sigma_is_fixed and not part.sigma > 0:
                where = slot if slot == "scene" else f"physics.{slot}"
                raise ConfigError(
                    f"{where}: its part '{type(part).__name__.lower()}' needs a sigma, in the unknown's units; "
                    "only those of gain and offset are found from the data"
                )


def chosen(config: Config) -> tuple[str, Callable[..., Result]]:
    """The name of `config.method`, and the method with its options.

    What is returned is called as `method(burst, config, callbacks=..., checkpoint=...)`; a method that has no use for
    the last two need not take them.

    Raises:
        ConfigError: No method has this name, it does not take these options, or it has no samples.
    """
    given = config.method if isinstance(config.method, dict) else {"type": config.method}
    name = str(given.get("type", "joint"))
    method = lookup("method", name, "method")
    options = {key: value for key, value in given.items() if key != "type"}
    values = validate(options_schema(method), options, f"method '{name}'")
    takes = inspect.signature(method).parameters
    if config.uncertainty.samples and "checkpoint" not in takes:  # it solves no problem
        raise ConfigError(f"uncertainty.samples: method '{name}' has no posterior to draw from; take method=joint")
    return name, lambda *data, **context: method(*data, **{k: v for k, v in context.items() if k in takes}, **values)


@register("method", "recording")
def recording(burst: Burst, config: Config) -> Result:
    """The sensor from a whole recording of a moving camera, as `deepir correct`; each frame's scene is corrected.

    Args:
        burst: All frames of the recording, in their order.
        config: The configuration.

    Raises:
        DataError: Few frames differ, or the camera stands still.
    """
    frames = burst.frames
    if (lost := ~burst.valid & ~burst.bad_pixels).any():
        frames = np.ma.masked_array(frames, lost)
    corrected = CorrectedRecording.of(lambda: iter(frames))
    maps, estimates = corrected.maps, [each.estimate for each in corrected.segments if each.estimate]
    result = neutral(corrected.frames, len(frames), burst.size, burst.bad_pixels | maps.bad_pixels)
    return dataclasses.replace(
        result,
        gain=maps.gain.astype(np.float32),
        offset=maps.offset.astype(np.float32),
        messages=list(dict.fromkeys(message for each in estimates for message in each.messages)),
        metrics={
            "correction": corrected.estimate.kept,
            "first_frames": [each.first for each in corrected.segments],
            "motion_error": corrected.estimate.motion_error,
            "iterations": 0,
            "evaluations": 0,
            "stop_reason": f"estimated from {len(corrected.keyframes.frames)} of {len(frames)} frames",
        },
    )
