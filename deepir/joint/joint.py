"""The method `joint`: all unknowns of a problem estimated together."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from deepir.burst import Burst
from deepir.config import Config
from deepir.curvature.uncertainty import pattern_cost
from deepir.errors import ConfigError, DataError
from deepir.evidence.contrast import contrast_message
from deepir.evidence.ghost import ghost_message
from deepir.evidence.levels import drift_message
from deepir.evidence.slow_strengths import shading_message
from deepir.evidence.strengths import hold_out
from deepir.evidence.stretched import equalised_message
from deepir.evidence.unexplained import unexplained_message
from deepir.joint.build import build
from deepir.joint.order import bridge_message, bridged
from deepir.joint.planned import plan
from deepir.joint.registered import registered
from deepir.joint.safeguard import safeguarded, unregistered
from deepir.joint.solved import collect
from deepir.noise.given import given_noise
from deepir.noise.lines import line_noise_message
from deepir.outliers.moving import moving_message
from deepir.priors.parts import Part
from deepir.problem import Problem
from deepir.problems.definition import Definition
from deepir.registry import lookup, register
from deepir.result import Result
from deepir.solve import Progress, solve


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
    try:
        motion, used, messages = registered(burst, config, definition)
    except DataError as refusal:
        if not definition.judged:
            raise
        return unregistered(burst, refusal)
    taken = used
    if definition.ordered and motion is not None:
        motion, taken = bridged(motion, used)
        messages += bridge_message(used, taken)
    valid = burst.valid & used[:, None, None]
    kept = dataclasses.replace(burst, frames=burst.frames[taken], valid=valid[taken])
    problem, geometry = build(config, kept, None if motion is None else motion[taken])
    problem = problem.to(config.device)
    problem.stretched = burst.stretched
    if burst.stretched:
        messages += equalised_message(np.where(valid, burst.frames, np.nan)[taken])
    if burst.clipped is not None:
        problem.ends = torch.from_numpy(burst.clipped[taken])[:, None].to(problem.data.device)
    messages += given_noise(problem, config)
    given = problem.alive()
    definition.initialise(problem, config.seed)
    _demand_strengths(problem)
    _demand_scene(problem)
    stages = plan(problem, definition, config)
    if config.scene.get("fit") and not problem.held_out.any():
        hold_out(problem, config.seed)
    solution = solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint)
    messages += definition.remarks(problem) + line_noise_message(problem) + moving_message(problem)
    messages += ghost_message(problem)
    if config.solver.max_iterations is None:  # a solve cut short leaves more than drift
        messages += drift_message(problem) + shading_message(problem)
        messages += unexplained_message(problem) or contrast_message(problem)
    found = given & ~problem.alive()
    burst = dataclasses.replace(burst, bad_pixels=burst.bad_pixels | found.cpu().numpy())
    cost = pattern_cost(problem, definition.weak)
    result = collect(problem, geometry, solution, burst, used, taken, messages, cost)
    result.metrics |= definition.figures(problem)
    return safeguarded(result, burst) if definition.judged else result


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
            if isinstance(part, Part) and not part.given and not part.sigma > 0:
                where = slot if slot == "scene" else f"physics.{slot}"
                raise ConfigError(
                    f"{where}: its part '{type(part).__name__.lower()}' needs a sigma, in the unknown's units; "
                    "only those of gain and offset are found from the data"
                )
