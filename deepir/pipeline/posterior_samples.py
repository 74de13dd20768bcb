"""Samples of the posterior by perturbed optimisation (Papandreou and Yuille 2010, Gaussian sampling).

The data get noise as they have, unknowns with a Gaussian prior a draw from it, and the solve goes on from its end.
These are exact samples where operator and priors are linear and Gaussian. Other penalties are not drawn from: detail
that they smooth away is missing. Weights, noise and masks stay as they were found.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from deepir.config import Config
from deepir.fields.base import Field
from deepir.joint_problem import AnyProblem
from deepir.optim.solve import Progress, Solution, solve
from deepir.pipeline.schedule import OWN
from deepir.problems.recipe import Recipe
from deepir.result import Array, Result
from deepir.schedule import Stage, Step

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
