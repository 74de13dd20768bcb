"""The order of a solve: stages, bands and frames, and a prior that is fitted to the scene once the sensor is known."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from deepir.arrays.statistics import sample_noise
from deepir.arrays.windows import fill_nearest
from deepir.assembly import build_scene
from deepir.burst import Burst
from deepir.config import Config
from deepir.config.components import make, validate
from deepir.config.schema import Fit
from deepir.errors import ConfigError, nearest
from deepir.estimation.prior_weight import is_oversmoothed, reduce_weight, weigh_scene
from deepir.fields.base import Pixels
from deepir.io.frames import select_frames
from deepir.joint_problem import AnyProblem
from deepir.messages import Message, within
from deepir.metrics import RegisteredAverage
from deepir.operators.warp import rescale_motion
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.problem import NoiseModel, Problem
from deepir.problems.recipe import Recipe
from deepir.registry import lookup
from deepir.result import Result
from deepir.schedule import Stage, Step

MAX_FRAMES = 10**6  # more frames than any burst has
ROUNDING_SIGMA = 0.29  # standard deviation of rounding to whole counts, 1 / √12
SIGNAL_WINDOW = 5  # px: side of the window whose mean is a sample's signal
MIN_RELATIVE_VARIANCE = 0.3  # of a sample, relative to the median: an offset is no light, and has no photon noise
PROBLEMS = ("nuc", "generic")  # problems that take several bands
#: What each band has by itself; the motion and the frames that are used are those of all.
OWN = ("scene", "gain", "offset", "level", "bad_pixels")
LANDWEBER_ITERATIONS = 30
JOINT_TOLERANCE = 0.03  # nats per scene pixel that ten iterations gain, where the sensor follows the scene


def make_recipe(config: Config) -> Recipe:
    """The recipe of `config.problem`.

    `effects.NAME` is false (left out), true, or a mapping of the effect's options. An effect that the problem does not
    list itself, of a plugin say, comes last.

    Raises:
        ConfigError: There is no such problem or effect, or the effect has no such option.
    """
    kind: type[Recipe] = lookup("problem", config.problem, "problem")
    switches = dict.fromkeys(kind.effect_names, True) | config.effects
    effects = []
    for name, switch in switches.items():
        lookup("effect", name, f"effects.{name}")
        if switch is not False:
            options = {} if switch is True or switch is None else switch
            effects.append(make("effect", name, options, f"effects.{name}"))
    return kind(effects)


def plan(problem: AnyProblem, recipe: Recipe, config: Config) -> list[Stage]:
    """The stages of `solver.plan`, or else the problem's own; `ConfigError` where they do not fit the unknowns."""
    given, cap = config.solver.plan, config.solver.max_iterations
    refinement = PriorRefinement(problem, config) if config.scene.get("fit") else None
    if given is None:
        stages: list[Stage] = recipe.plan(problem)
        where = f"problem '{config.problem}' (or take problem=generic)"
    else:
        where = "solver.plan"
        steps = [tuple(Step(**p.model_dump() | {"group": tuple(p.group)}) for p in s.steps) for s in given]
        stages = [Stage(s.name, each, s.iterations) for s, each in zip(given, steps, strict=True)]
    if refinement is not None:
        recipe.sensor_follows = bool(refinement.follows)
        stages = refinement.after(stages, recipe.weigh_prior)
    for stage in stages:
        _check_groups(problem, stage, f"{where}, stage '{stage.name}'")
    return [s if cap is None else dataclasses.replace(s, iterations=min(s.iterations, cap)) for s in stages]


def network_message(problem: AnyProblem, stages: list[Stage]) -> Iterator[str]:
    """A line if a network draws the scene and moves by L-BFGS together with the sensor, for lack of `scene.fit`."""
    moved = {name for stage in stages for step in stage.steps if step.method == "lbfgs" for name in step.group}
    scene = next((problem.fields[name] for name in problem.scenes if name in moved), None)
    if scene is not None and scene.is_network:
        yield Message(
            "network-without-fit",
            f"scene: '{type(scene).__name__.lower()}' is a network, and moves by L-BFGS together with all others, "
            "which mostly leaves much of the scene's contrast in the gain: fit it once the sensor is known, with "
            "scene.fit.method=adam scene.fit.lr=0.003 scene.fit.iterations=500",
        )


def _check_groups(problem: AnyProblem, stage: Stage, where: str) -> None:
    if all(step.method == "eliminate" for step in stage.steps):
        raise ConfigError(f"{where}: a stage needs a step that is not 'eliminate'")
    for step in stage.steps:
        if step.method != "eliminate":
            lookup("optimiser", step.method, f"{where}: method")
        if unknown := set(step.rates) - set(step.group):
            other = unknown.pop()
            raise ConfigError(f"{where}: rates: no '{other}' in the group; {nearest(other, step.group)}")
        for name in step.group:
            if name not in problem.fields:
                raise ConfigError(f"{where}: no unknown '{name}'; {nearest(name, problem.fields)}")
            if step.method == "eliminate" and name not in problem.closed_form():
                raise ConfigError(f"{where}: '{name}' has no closed form; {nearest(name, problem.closed_form())}")


Mask = np.ndarray[Any, Any]


def demand_order(select: str | int | Sequence[int] | None, problem: str) -> None:
    """Raise `ConfigError` if `data.frames` does not keep frames one after the other."""
    if isinstance(select, str | int | None) and ":" not in str(select):
        return
    chosen = select_frames(np.arange(MAX_FRAMES), select, "data")
    if (np.diff(chosen) != 1).any():
        raise ConfigError(
            f"data.frames={select!r}: '{problem}' needs frames that follow each other in time; give a count or a slice"
        )


def interpolate_missing_motion(motion: Tensor, used: Mask) -> tuple[Tensor, Mask]:
    """Motions (N, 3, 3) with gaps filled in, and which frames are taken, (N,): all from the first to the last used."""
    at, known = np.arange(len(used)), np.flatnonzero(used)
    entries = motion.flatten(1).numpy()
    filled = np.stack([np.interp(at, known, entry[known]) for entry in entries.T], 1)
    return torch.from_numpy(filled).view_as(motion), (at >= known[0]) & (at <= known[-1])


def interpolation_message(used: Mask, taken: Mask) -> Iterator[str]:
    """A line for each frame that is taken without being used."""
    for k in np.flatnonzero(taken & ~used):
        yield Message(
            "frame-interpolated",
            f"frame {k} is bridged: where the camera was then, on which the next frames depend, is interpolated",
        )


def given_noise(problem: Problem, config: Config) -> list[str]:
    """Take the noise that the configuration gives, if it does; a message where whole counts cannot have so little."""
    if config.noise == "auto":
        return []
    read, photon = config.noise.read**2, 1 / (config.noise.photons or math.inf)
    # Until there is a prediction, the mean of the neighbours: of single samples the low ones would seem the surest.
    data = problem.data + problem.reference
    signal = avg_pool2d(data, SIGNAL_WINDOW, stride=1, padding=SIGNAL_WINDOW // 2, count_include_pad=False)
    variance = read + photon * signal.clamp_(min=0)
    if not variance.min() > 0:
        raise ConfigError("noise: with read = 0 each sample must be positive, or have photons")
    least = MIN_RELATIVE_VARIANCE * float(variance.median())
    problem.precision.copy_((problem.precision > 0) / variance.clamp_(min=least))
    problem.noise = NoiseModel(read, photon, least)
    if variance.max() > ROUNDING_SIGMA**2 / 10 or data.max() <= 1 or (data % 1).any():
        return []
    return [
        Message(
            "noise-below-rounding",
            f"noise.read is {config.noise.read:g} in units of the data, and rounding to whole counts makes "
            f"{ROUNDING_SIGMA}: is the configuration meant for frames in [0, 1]?",
        )
    ]


def solve_bands(burst: Burst, solve: Callable[[Burst], Result]) -> Result:
    """The clearest band by itself, then the others with its motion: a result whose arrays have the bands first.

    The burst is that of the first band, with the others in `bands`; `solve` takes a burst of one band.
    """
    bands = [dataclasses.replace(burst, bands=()), *burst.bands]
    lead = int(np.argmax([contrast_to_noise(band) for band in bands]))
    first = solve(bands[lead])
    motion = None
    if first.frames_used.sum() > 1:  # else its motion is not trusted, and each band finds its own
        coarser = np.divide(burst.size, first.scene.shape[-2:])
        motion = rescale_motion(torch.from_numpy(first.motion), coarser).numpy()
    results = [first if c == lead else solve(dataclasses.replace(band, motion=motion)) for c, band in enumerate(bands)]
    return _stacked(results, lead)


def contrast_to_noise(band: Burst) -> float:
    """How much the frames change as the camera moves, relative to their noise; a fixed pattern does not count."""
    if len(band.frames) < 2:
        return 0.0
    levels = [np.median(frame[ok]) if ok.any() else 0.0 for frame, ok in zip(band.frames, band.valid, strict=True)]
    change = np.diff(np.where(band.valid, band.frames - np.reshape(levels, (-1, 1, 1)), 0.0), axis=0)
    noise = sample_noise(torch.from_numpy(band.frames), torch.from_numpy(band.valid & ~band.bad_pixels))
    return float(change.std()) / max(noise, 1e-30)


def _stacked(results: list[Result], lead: int) -> Result:
    """One result of those of the bands; `metrics` are those of the clearest, and of each under `bands`."""
    first = results[lead]
    shared = set.intersection(*(set(each.extra) for each in results))
    spread = set.intersection(*(set(each.uncertainty) for each in results))
    whole = dataclasses.replace(
        first,
        example=results[0].example,
        extra={name: np.stack([each.extra[name] for each in results]) for name in sorted(shared)},
        uncertainty={name: np.stack([each.uncertainty[name] for each in results]) for name in sorted(spread)},
        metrics=first.metrics | {"clearest_band": lead, "bands": [each.metrics for each in results]},
        messages=[within(line, f"band {c}") for c, each in enumerate(results) for line in each.messages],
    )
    for name in OWN:
        setattr(whole, name, np.stack([getattr(each, name) for each in results]))
    return whole


class PriorRefinement:
    """Field and penalties of each scene, by a `scene.fit`, and the stages in which they are fitted."""

    def __init__(self, problem: AnyProblem, config: Config) -> None:
        self.fit = Fit(**validate(Fit, config.scene["fit"], "scene.fit"))
        self.from_average = config.scene.get("init", "average") == "average"
        #: By the unknown's name.
        self.scenes = {
            name: build_scene(config.scene, problem.fields[name].shape, shown_by[0].data.device)
            for name, shown_by in problem.scenes.items()
        }
        pixels = all(isinstance(field, Pixels) for field, _ in self.scenes.values())
        together = self.fit.with_sensor and pixels and all(map(has_fourier_model, problem.data_sets))
        cut_off = any(each.saturation is not None for each in problem.data_sets)
        #: Gain and offset, if these follow the scene; where samples are cut off it is not sure enough of itself.
        self.follows = tuple(problem.closed_form()) if together and not cut_off else ()
        frames = min(len(each.data) for each in problem.data_sets)
        self.tolerance = JOINT_TOLERANCE / frames if self.follows else Stage.tolerance

    def after(self, stages: Sequence[Stage], weigh: Callable[[Any], None] = weigh_scene) -> list[Stage]:
        """The stages, and those of the prior; where it is stopped by held-out samples, none before saw them.

        `weigh` sets the weights of its penalties.
        """
        fit, stopped = self.fit, self.fit.average > 0
        before = [dataclasses.replace(s, use_held_out=s.use_held_out and not stopped) for s in stages]
        follow = (Step(self.follows, "eliminate"),) if self.follows else ()
        steps = (Step(tuple(self.scenes), fit.method, fit.lr, average=fit.average), *follow)
        rounds = [f"prior {i + 1}" for i in range(fit.rounds)] if fit.rounds > 1 else ["prior"]
        one = Stage("prior", steps, fit.iterations, weigh, not stopped, bool(follow), self.tolerance)
        mine = [dataclasses.replace(one, name=name) for name in rounds]
        mine[0] = dataclasses.replace(mine[0], change=self.enter)
        if self.follows:
            mine.append(
                dataclasses.replace(mine[-1], name="looser", change=None, prepare=reduce_weight, needed=is_oversmoothed)
            )
        return [*before, *mine]

    @torch.no_grad()
    def enter(self, problem: AnyProblem) -> None:
        """Put the prior's fields in the place of those that found the sensor."""
        for name, (field, penalties) in self.scenes.items():
            average = registered_average(problem.scenes[name][0]) if self.from_average else None
            field.init_from(problem.fields[name]() if average is None else average)
            problem.represent(name, field, penalties)


@torch.no_grad()
def registered_average(problem: Problem) -> Tensor:
    """The scene that the samples show that are not held out, without a prior; all other unknowns as they are.

    The first round averages what the frames show, which the spline blurs; the others give back what is missing
    (Landweber 1951). That converges where an operator's sums do not cancel, as those of a coded aperture of both signs
    do: else the scene stays as it is.
    """
    values: Any = problem.values()
    seen = (problem.fitted() > 0).to(problem.data)
    average = RegisteredAverage(problem, values, seen)
    shown = residual = problem.data - average.at_zero
    least = 0.3 * float(average.weight.max())
    weight, known = average.weight.clamp(min=least), average.weight > least
    scene = fill_nearest(average.backproject(shown) / weight, known)
    for _ in range(LANDWEBER_ITERATIONS):
        residual = problem.data - problem.predict({**values, "scene": scene})
        scene = scene + average.backproject(residual) / weight
    converges = (seen * residual.square()).sum() <= (seen * shown.square()).sum()
    return scene if converges else problem.fields["scene"]()
