"""Whether rows or columns jump from frame to frame, and by how much: from the means of the residuals along them."""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.noise import MAD, typical_noise
from deepir.priors.line_noise import LineNoise
from deepir.priors.shading import Shading
from deepir.problem import Problem

ENOUGH = 3  # frames: two leave nothing, for a scene and a pattern explain any two values of a row
CERTAIN = 2.0  # times the variance that white noise leaves in the means of lines, from which they jump


def line_noises(problem: Problem) -> list[LineNoise]:
    """Those that the problem knows of."""
    fields = [problem.fields[name] for name in problem.free()]
    return [module for field in fields for module in field.modules() if isinstance(module, LineNoise)]


@torch.no_grad()
def estimate_line_noise(problem: Problem) -> None:
    """Set the strength of what lines jump by, and the jumps to what is likeliest with all else held.

    Scene and fixed pattern take up two of the n values that a line's jumps are, whatever they are: of the variance a share
    of `(n - 2) / n` is left in the residuals.
    """
    fields = line_noises(problem)
    if not fields or len(problem.data) < ENOUGH:
        return
    residual, precision = problem.data - problem.predict(problem.values()), problem.fitted()
    left = (len(residual) - 2) / len(residual)
    for field in fields:
        along = -3 - field.across
        total = precision.sum(along, keepdim=True)
        known = total > 0
        mean = (precision * residual).sum(along, keepdim=True) / total.clamp(min=1e-30)
        mean += field() - field.neutral
        white = float(total[known].median().reciprocal())
        step = mean.diff(dim=field.across)[known.narrow(field.across, 1, known.shape[field.across]-1) & known.narrow(field.across, 0, known.shape[field.across]-1)]
        found = float((MAD * step.abs().median()) ** 2) / 2
        DEBUG.append((type(field).__name__, found / white / left, (max(found/left-white,0))**.5/typical_noise(problem.precision)))
        if field.given:
            variance = float(field.sigma) ** 2
        else:
            variance = found / left - white if found > CERTAIN * white * left else 0.0
            field.sigma.fill_(variance**0.5)
        if variance > 0:
            field.step.fill_(white**0.5)
            field.values.copy_(mean * known * variance / (variance + white) / field.step)
DEBUG = []


def in_polynomials(problem: Problem, frame: Shading) -> Tensor:
    """The variance that lines which jump have in each frame's level and polynomials, (terms + 1,)."""
    of_level = frame.of_y[:1] * 0
    of_y, of_x = torch.cat((of_level, frame.of_y)), torch.cat((of_level, frame.of_x))
    found = torch.zeros(len(of_y), dtype=torch.float64, device=of_y.device)
    for field in line_noises(problem):
        others = of_x if field.across == -2 else of_y
        found += (others == 0) * float(field.sigma) ** 2 / field.shape[field.across]
    return found


def less_lines(problem: Problem, columns: Tensor) -> Tensor:
    """Values (..., h, w) less their means along lines that jump: these tell nothing."""
    for field in line_noises(problem):
        if field.sigma > 0:
            columns = columns - columns.mean(-3 - field.across, keepdim=True)
    return columns
