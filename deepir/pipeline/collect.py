"""The result of a solved problem: values in the gauge, with their uncertainty."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from deepir.arrays.statistics import median_sigma
from deepir.burst import Burst
from deepir.config import Config
from deepir.effects.outliers import observed
from deepir.effects.saturation import bounded, clipping_message
from deepir.effects.shading import added_flux
from deepir.estimation.prior_weight import uncertainty
from deepir.fields.base import Field
from deepir.fields.line_noise import LineNoise
from deepir.fields.sensor_maps import GaussianMap
from deepir.joint_problem import AnyProblem
from deepir.messages import Message
from deepir.operators.motion_models import Geometry, displacements, homographies
from deepir.optim.solve import Progress, Solution, solve
from deepir.pipeline.schedule import OWN
from deepir.problem import Problem
from deepir.problems.recipe import Recipe
from deepir.result import Array, Result, neutral, to_gauge
from deepir.schedule import Stage, Step

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


Callbacks = Sequence[Callable[[Progress], None]]


def sampled_uncertainty(
    problem: AnyProblem, last: Stage, config: Config, callbacks: Callbacks, collect: Callable[[Solution], Result]
) -> dict[str, Array]:
    """Standard deviations of all that a result holds, from `config.uncertainty.samples`; {} without these.

    Args:
        problem: A solved one.
        last: Stage that ended the solve.
        config: The configuration.
        callbacks: Called after each iteration.
        collect: The result of a solution.
    """
    samples = posterior_samples(problem, last, config.uncertainty.samples or 0, config.seed, callbacks)
    found = [(end := collect(s)).extra | {name: getattr(end, name) for name in (*OWN, "motion")} for s in samples]
    names = set.intersection(*map(set, found)) if found else set()
    arrays = {name: np.stack([each[name] for each in found]) for name in sorted(names)}
    return {name: a.std(0, float, ddof=1).astype(np.float32) for name, a in arrays.items() if a.dtype.kind == "f"}


def posterior_samples(
    problem: AnyProblem, last: Stage, count: int, seed: int, callbacks: Callbacks = ()
) -> Iterator[Solution]:
    """Samples of all unknowns of a solved problem, which is left as it was.

    Args:
        problem: All that is free is sampled.
        last: Stage that ended the solve; its method and iterations are those of the samples.
        count: Number of samples.
        seed: Of the draws.
        callbacks: Called after each iteration.
    """
    stage, found = _stage(problem, last), {name: each.clone() for name, each in problem.state_dict().items()}
    generator = torch.Generator().manual_seed(seed)
    for k in range(count):
        draws = _perturb(problem, generator)

        def report(progress: Progress, k: int = k) -> None:
            now = dataclasses.replace(progress, stage=f"sample {k + 1} of {count}", done=(k + progress.done) / count)
            for callback in callbacks:
                callback(now)

        solution = solve(problem, [stage], callbacks=[report])
        with torch.no_grad():
            for parameter, draw in draws:
                parameter.add_(draw)
            yield dataclasses.replace(solution, values=problem.values())
        problem.load_state_dict(found)


def _stage(problem: AnyProblem, last: Stage) -> Stage:
    """All that is free together; a network by the method that fitted it, beside the others."""
    free, eliminate = Recipe.split(problem)
    moved = tuple(step for step in last.steps if step.method not in ("lbfgs", "eliminate"))
    others = tuple(name for name in free if not any(name in step.group for step in moved))
    steps = (*moved, *([Step(others)] if others else []), *eliminate)
    return Stage("posterior", steps, last.iterations, use_held_out=last.use_held_out, tolerance=last.tolerance)


@torch.no_grad()
def _perturb(problem: AnyProblem, generator: torch.Generator) -> list[tuple[nn.Parameter, Tensor]]:
    """Perturb the data; the draws of the prior, by which the solution of these data is to be moved."""
    before = [each.predict(each.values()) for each in problem.data_sets]
    draws = [pair for field in dict.fromkeys(problem.fields.values()) for pair in _draws(field, generator)]
    for parameter, draw in draws:
        parameter.add_(draw)
    for each, prediction in zip(problem.data_sets, before, strict=True):
        noise = torch.randn(each.data.shape, generator=generator).to(each.data) * each.precision.rsqrt()
        each.data += torch.where(each.precision > 0, noise, 0) - (each.predict(each.values()) - prediction)
    for parameter, draw in draws:
        parameter.sub_(draw)
    return draws


def _draws(field: Field, generator: torch.Generator) -> Iterator[tuple[nn.Parameter, Tensor]]:
    """Parameters of Gaussian parts, and draws from their priors, whose precision is the penalty's curvature."""
    for part in field.modules():
        parameters = [each for each in part.parameters(recurse=False) if each.requires_grad]
        if not (isinstance(part, Field) and hasattr(part, "sigma") and parameters):
            continue
        with torch.enable_grad():
            if (penalty := part.penalty()) is None:
                continue
            slopes = torch.autograd.grad(penalty, parameters, create_graph=True)
            curvatures = torch.autograd.grad([each.sum() for each in slopes], parameters)
        for parameter, curvature in zip(parameters, curvatures, strict=True):
            yield parameter, torch.randn(parameter.shape, generator=generator).to(parameter) * curvature.rsqrt()
