"""Whether rows or columns jump from frame to frame, and by how much: from the means of the residuals along them."""

from __future__ import annotations

import dataclasses

import torch
from torch import Tensor

from deepir.levels import level_names
from deepir.noise import MAD, typical_noise
from deepir.priors.line_noise import LineNoise
from deepir.priors.shading import Shading
from deepir.problem import Problem
from deepir.stage import Stage, Step

ENOUGH = 3  # frames: a scene and a pattern explain any two values of a line
LITTLE = 0.15  # of a sample's noise: jumps that cost little, and may as well be something else
CERTAIN = 4.0  # variance of the means along lines, in that which white noise leaves, from which they jump


def line_noises(problem: Problem) -> list[LineNoise]:
    """Those that the problem knows of."""
    fields = [problem.fields[name] for name in problem.free()]
    return [module for field in fields for module in field.modules() if isinstance(module, LineNoise)]


def lines_jump(problem: Problem) -> bool:
    """Whether any do, as far as is known."""
    return any(field.sigma > 0 for field in line_noises(problem))


def with_jumps(problem: Problem, scene: Stage) -> list[Stage]:
    """The stage of the scene; or, where lines jump, one in which the jumps follow the scene.

    What all frames' jumps in a line of the scene have in common, these do not tell from the scene: its penalties do.
    """
    if not line_noises(problem):
        return [scene]
    levels = [name for name in level_names(problem) if name in problem.free()]
    step = Step((*scene.steps[0].group, *levels))
    return [
        dataclasses.replace(scene, needed=lambda it: not lines_jump(it)),
        dataclasses.replace(scene, steps=(step,), needed=lines_jump),
    ]


@torch.no_grad()
def line_noise_message(problem: Problem) -> list[str]:
    """Say so if lines jump."""
    noise = typical_noise(problem.precision)
    found = [(field.lines, float(field.sigma)) for field in line_noises(problem) if field.sigma > 0]
    return [
        f"{lines} jump by {sigma:.3g} from frame to frame, {sigma / noise:.2g} times a sample's noise: "
        "estimated and taken out"
        for lines, sigma in found
    ]


@torch.no_grad()
def estimate_line_noise(problem: Problem) -> list[LineNoise]:
    """Set by how much lines jump, and each jump to its mean with all else held.

    Scene and fixed pattern explain two of the n values of a line, whatever these are: of the variance of what it
    jumps by a share of `(n - 2) / n` is left in the residuals. Returns those that are found to jump for the first time.
    """
    fields, new = line_noises(problem), list[LineNoise]()
    if not fields or len(problem.data) < ENOUGH:
        return new
    residual, precision = problem.data - problem.predict(problem.values()), problem.fitted()
    for field in fields:
        mean, known, white = _means(residual, precision, field)
        if field.given:
            variance = float(field.sigma) ** 2
        else:
            left = (len(mean) - 2) / len(mean)
            variance = _variance(mean, known, field.across) / left
            samples = residual[0].numel() / mean[0].numel()
            variance = variance - white if variance > white * max(CERTAIN, LITTLE**2 * samples) else 0.0
            new += [field] if variance and not field.sigma > 0 else []
            field.sigma.fill_(variance**0.5)
        field.step.fill_(white**0.5)
        field.values.copy_(mean * known * variance / (variance + white) / field.step)
    return new


def _means(residual: Tensor, precision: Tensor, field: LineNoise) -> tuple[Tensor, Tensor, float]:
    """Each line's mean above what is predicted without jumps, where it is known, and its variance of white noise."""
    along = -3 - field.across
    total = precision.sum(along, keepdim=True)
    mean = (precision * residual).sum(along, keepdim=True) / total.clamp(min=1e-30)
    known = total > 0
    return mean + field() - field.neutral, known, float(total[known].median().reciprocal())


def _variance(mean: Tensor, known: Tensor, across: int) -> float:
    """Of what lies side by side, without what is slow across the lines, or far out."""
    both = known.narrow(across, 1, known.shape[across] - 1) & known.narrow(across, 0, known.shape[across] - 1)
    return float((MAD * mean.diff(dim=across)[both].abs().median()) ** 2) / 2


def in_polynomials(problem: Problem, frame: Shading) -> Tensor:
    """The variance that jumps have in each frame's level and polynomials, (terms + 1,)."""
    level = torch.zeros_like(frame.of_y[:1])
    of_y, of_x = torch.cat((level, frame.of_y)), torch.cat((level, frame.of_x))
    found = torch.zeros(len(of_y), dtype=torch.float64, device=of_y.device)
    for field in line_noises(problem):
        constant = (of_x if field.across == -2 else of_y) == 0
        found += constant * float(field.sigma) ** 2 / field.shape[field.across]
    return found


def less_lines(problem: Problem, values: Tensor) -> Tensor:
    """Values (..., h, w) less their means along lines that jump: these tell nothing."""
    for field in line_noises(problem):
        if field.sigma > 0:
            values = values - values.mean(-3 - field.across, keepdim=True)
    return values
