"""Several data sets solved as one problem, and the method `bursts`: bursts of a recording, with one sensor."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir import registration
from deepir.assembly import FIRST, build, build_data_sets, data_sets, make_operator
from deepir.burst import Burst
from deepir.config import Config
from deepir.errors import ConfigError, DataError
from deepir.joint_problem import JointProblem
from deepir.messages import within
from deepir.operators import Warp
from deepir.operators.motion_models import Canvas, Geometry, homographies
from deepir.optim.objective import Checkpoint, has_held_out, hold_out
from deepir.optim.solve import Progress, Solution, solve
from deepir.pipeline.collect import make_result, sampled_uncertainty
from deepir.pipeline.register import frames_of_burst, motion_model, register_frames
from deepir.pipeline.schedule import given_noise, make_recipe, network_message, plan
from deepir.problem import Problem
from deepir.problems.recipe import Recipe
from deepir.registry import register
from deepir.result import Result

#: Motion within a burst along each axis, as a share of the frame's shorter side, beyond which more tells little more.
REACH = 0.1


@dataclass(frozen=True)
class RegisteredBurst:
    """Frames of a recording that register: their numbers, the frames, (N, 3, 3) motion, and messages."""

    numbers: np.ndarray
    burst: Burst
    motion: Tensor
    messages: list[str]

    @property
    def span(self) -> float:
        """Motion along x and y, px, as far as it counts."""
        most = REACH * min(self.burst.size)
        return float(np.ptp(self.motion[:, :2, 2].numpy(), axis=0).clip(max=most).sum())


@register("method", "bursts")
def bursts(
    burst: Burst,
    config: Config,
    *,
    count: int = 3,
    frames: int = 8,
    callbacks: Sequence[Callable[[Progress], None]] = (),
    checkpoint: Checkpoint | None = None,
) -> Result:
    """The sensor from several bursts of a recording, solved together, with a scene for each burst.

    Args:
        burst: All frames of the recording, in their order.
        config: The configuration, of a problem that solves several data sets.
        count: Bursts, evenly spread over the recording.
        frames: Of each burst.
        callbacks: Called with a `Progress` after each iteration.
        checkpoint: Where the solver saves its state.

    Raises:
        ConfigError: `count` or `frames` is too small, or the problem or its physics are not of this kind.
        DataError: No burst registers.
    """
    recipe = make_recipe(config)
    if count < 1 or frames < max(recipe.frames, 2):
        raise ConfigError(
            f"method.count = {count}, method.frames = {frames}: at least one burst of two frames is needed"
        )
    if not recipe.several or motion_model(config) is None:
        raise ConfigError(
            "method 'bursts' needs a problem of several data sets, and a motion that starts at 'register': take "
            "problem=recording, or problem=generic with a stage 'warp'"
        )
    chosen = choose_bursts(burst, config, recipe, count, frames)
    size = burst.size
    operators = [make_operator(config, size, len(each.numbers), each.motion)[0] for each in chosen]
    warps = [stage for each in operators for _, stage in each.named()[:1] if isinstance(stage, Warp)]
    # Scenes of one size, so that what they have in common is told apart.
    canvas = Canvas.around(warps) if warps else None
    built = [build(config, each.burst, each.motion, canvas=canvas) for each in chosen]
    names = [FIRST, *(f"burst{k}" for k in range(1, len(chosen)))]
    problems = {name: problem.to(config.device) for name, (problem, _) in zip(names, built, strict=True)}
    messages = [line for each in chosen for line in each.messages]
    for each in problems.values():
        messages += given_noise(each, config)
        share_camera(problems[FIRST], each)
    alive = [each.alive() for each in problems.values()]
    joint = recipe.join(problems, config.seed)

    def collect(solution: Solution) -> Result:
        lost = torch.stack([was & ~each.alive() for was, each in zip(alive, joint.data_sets, strict=True)])
        bad = burst.bad_pixels | (lost.double().mean(0) > 0.5).cpu().numpy()
        known = dataclasses.replace(burst, bad_pixels=bad)
        return _collected(joint, solution, known, chosen, [place for _, place in built], messages)

    return solve_jointly(joint, recipe, config, callbacks, checkpoint, collect)


def choose_bursts(burst: Burst, config: Config, recipe: Recipe, count: int, frames: int) -> list[RegisteredBurst]:
    """In each of `count` equal parts of a recording, the frames about its middle that move most and register.

    Raises:
        DataError: No part has any.
    """
    count = max(1, min(count, len(burst.frames) // frames))
    edges = np.linspace(0, len(burst.frames), count + 1).astype(int)
    parts = [_best_burst(burst, config, recipe, range(*ends), frames) for ends in itertools.pairwise(edges)]
    if found := [each for each in parts if each is not None]:
        return found
    raise DataError(
        f"{burst.source}: none of {count} bursts registers: the frames do not move as a whole, or show too little. "
        "`deepir correct` does without registration"
    )


def _best_burst(burst: Burst, config: Config, recipe: Recipe, part: range, frames: int) -> RegisteredBurst | None:
    """The spacing of the frames doubles until they move enough, or fewer register."""
    best: RegisteredBurst | None = None
    frames, spacing = min(frames, len(part)), 1
    while (frames - 1) * spacing < len(part):
        first = part.start + (len(part) - (frames - 1) * spacing) // 2
        numbers = first + spacing * np.arange(frames)
        spacing *= 2
        some = frames_of_burst(burst, numbers)
        try:
            motion, used, messages = register_frames(some, config, recipe)
        except DataError:
            continue
        assert motion is not None
        found = RegisteredBurst(numbers[used], frames_of_burst(some, used), motion[used], messages)
        if best is not None and len(found.numbers) * found.span <= len(best.numbers) * best.span:
            break
        best = found
    return best


def share_camera(first: Problem, other: Problem) -> None:
    """Let a burst have the unknowns of another that are not of the scene, and not of single frames: the camera's."""
    shapes = other.operator.slots(other.fields["scene"].shape, len(other.data))
    for slot, shape in shapes.items():
        if shape[0] == 1:
            name = other.slots[slot]
            other.fields[name] = first.fields[name]  # type: ignore[index]


def _collected(
    joint: JointProblem,
    solution: Solution,
    burst: Burst,
    chosen: Sequence[RegisteredBurst],
    places: Sequence[Geometry],
    messages: list[str],
) -> Result:
    """Gain and offset of the camera, and the scene of each burst on the grid of its first frame, (bursts, H, W)."""
    results = []
    for each, part, place in zip(joint.data_sets, chosen, places, strict=True):
        used = np.ones(len(part.numbers), bool)
        own = {name: solution.values[whole] for name, whole in joint.names_in(each).items()}
        frames = dataclasses.replace(part.burst, bad_pixels=burst.bad_pixels)
        mine = dataclasses.replace(solution, values=own)
        results.append(make_result(each, place, mine, frames, used, used, [], math.nan))
    whole = results[0]
    of_camera = set.intersection(*(set(joint.names_in(each).values()) for each in joint.data_sets))
    n_frames = len(burst.frames)
    motion, level = np.full((n_frames, 3, 3), np.nan), np.zeros(n_frames, np.float32)
    for part, result in zip(chosen, results, strict=True):
        motion[part.numbers], level[part.numbers] = result.motion, result.level
    return dataclasses.replace(
        whole,
        scene=np.stack([each.scene for each in results]),
        motion=motion,
        level=level,
        frames_used=np.isfinite(motion).all((1, 2)),
        bad_pixels=burst.bad_pixels,
        messages=list(dict.fromkeys([*messages, *(line for each in results for line in each.messages)])),
        extra={name: each for name, each in whole.extra.items() if name in of_camera},
        uncertainty={name: each for name, each in whole.uncertainty.items() if name != "scene"},
        metrics=whole.metrics | {"bursts": [part.numbers.tolist() for part in chosen]},
    )


def solve_data_sets(
    burst: Burst, config: Config, *, callbacks: Sequence[Any] = (), checkpoint: Checkpoint | None = None
) -> Result:
    """The result of the first data set; what the others have of their own is in `extra`, by its unknown's name."""
    recipe = make_recipe(config)
    motions: dict[str, Tensor | None] = {}
    kept, messages, used = {}, [], {}
    for name, own, frames in data_sets(config, burst):
        motion, used[name], found = register_frames(frames, own, recipe)
        motions[name] = None if motion is None else motion[used[name]]
        kept[name] = frames_of_burst(frames, used[name])
        messages += found if name == FIRST else [within(line, f"data set '{name}'") for line in found]
    others = {name: each for name, each in kept.items() if name != FIRST}
    several = dataclasses.replace(kept[FIRST], datasets=others)

    def built() -> tuple[JointProblem, dict[str, Geometry]]:
        problems, places = build_data_sets(config, several, motions)
        for name, own, _ in data_sets(config, several):
            given_noise(problems[name].to(config.device), own)
        return recipe.join(problems, config.seed), places

    problem, places = built()
    if relative := relative_motions(problem, config, several):
        for name, motion in relative.items():
            motions[name] = motion if (before := motions[name]) is None else motion @ before
        problem, places = built()
    for each in problem.data_sets[1:]:
        if problem.names_in(each)["scene"] == "scene":
            start_radiometry(each)
    frames_used, place = used[FIRST], places.pop(FIRST)

    def collect(solution: Solution) -> Result:
        result = make_result(problem.first, place, solution, burst, frames_used, frames_used, list(messages), math.nan)
        for name, each in places.items():
            add_unknowns(result, problem, name, each)
        return result

    return solve_jointly(problem, recipe, config, callbacks, checkpoint, collect)


def solve_jointly(
    problem: JointProblem,
    recipe: Recipe,
    config: Config,
    callbacks: Sequence[Any],
    checkpoint: Checkpoint | None,
    collect: Callable[[Solution], Result],
) -> Result:
    """Run the plan of a problem that is started; `collect` makes the result of a solution."""
    stages = plan(problem, recipe, config)
    if config.scene.get("fit") and not has_held_out(problem):
        hold_out(problem, config.seed)
    messages = list(network_message(problem, stages))
    solution = solve(problem, stages, callbacks=callbacks, checkpoint=checkpoint)
    messages += recipe.warnings(problem, complete=config.solver.max_iterations is None)
    result = collect(solution)
    result.messages = list(dict.fromkeys([*result.messages, *messages]))
    result.uncertainty |= sampled_uncertainty(problem, stages[-1], config, callbacks, collect)
    return result


@torch.no_grad()
def relative_motions(problem: JointProblem, config: Config, burst: Burst) -> dict[str, Tensor]:
    """Where frame 0 of each further data set lies in a scene that it shares, (1, 3, 3), px of its detector.

    Its frame is registered with what it would see of the scene as the first data set shows it, unless its motion
    starts elsewhere.

    Raises:
        DataError: A frame does not register.
    """
    found = {}
    for each, (name, own, frames) in zip(problem.data_sets, data_sets(config, burst), strict=True):
        model = motion_model(own)
        if name == FIRST or model is None or problem.names_in(each)["scene"] != "scene":
            continue
        seen = torch.cat([each.predict(each.values())[:1], each.data[:1]])[:, 0].cpu()
        seen = (seen - seen.mean((1, 2), keepdim=True)) / seen.std((1, 2), keepdim=True)  # of other units
        pair = registration.register(seen, model=model, ignore=torch.from_numpy(frames.bad_pixels))
        if not pair.used.all():
            raise DataError(
                f"datasets.{name}: its first frame does not register with the scene of the first data set: give its "
                "motion's init, or scene: own if it shows another scene"
            )
        found[name] = pair.motion[1:]
    return found


@torch.no_grad()
def start_radiometry(data_set: Problem) -> None:
    """Start gain and offset of a camera in units of its own by least squares of its data on the scene's flux.

    Those that have parts about one and zero stay there: they are in the units of the scene.
    """
    fields = [data_set.fields[name] for name in data_set.gain_and_offset()]
    free = [field for field in fields if not field.parts() and any(p.requires_grad for p in field.parameters())]
    if len(free) < 2:
        return
    used = data_set.precision > 0
    flux = data_set.flux(data_set.values())[used].double()
    data = data_set.data[used].double()
    slope = ((flux - flux.mean()) * (data - data.mean())).mean() / flux.var(correction=0)
    for field, value in zip(fields, (slope, data.mean() - slope * flux.mean()), strict=True):
        field.init_from(value.to(data_set.data).expand(field.shape))


@torch.no_grad()
def add_unknowns(result: Result, problem: JointProblem, name: str, place: Geometry) -> None:
    """Add a further data set's own unknowns to `extra`; its scene lies on the grid of its frame 0."""
    each: Any = problem.others[name]
    values = each.values()
    for own, known in problem.names_in(each).items():
        if not known.startswith(f"{name}_"):
            continue
        value = values[own]
        if own == "scene":
            found = place.crop(each.operator.to_pixels(value))
        elif own == each.motion_unknown():
            found = homographies(value)
        else:
            found = value.squeeze()
        result.extra[known] = found.cpu().numpy()
