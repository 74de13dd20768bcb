"""Contrasts of whole frames: of pictures, each stretched by its own, and of a camera whose response drifts.

A frame that is a thousandth brighter throughout is brighter by more where the scene is bright: slow parts of scene and
pattern that explain this, too, are larger than either.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.estimation.gain_offset_evidence import GainOffsetEvidence
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.problem import Problem

DEGREE, SLOW = 4, 2  # of what is slow over a frame, and over a part: shading looks like contrast there
LARGEST = 3.0  # contrast that is believed
GROSS = 0.02  # contrasts that a start tells from the pattern
ALIKE = 0.002  # contrasts that a round finds of pictures that are all of one range
PARTS, ENOUGH = 3, 40_000  # of a frame, along each axis, and samples of it in all
#: Standard errors by which contrasts differ that drift, as the parts tell them, and by how much at least. Those of a
#: camera that does not drift differ by 5.6 at most, mostly by 1 to 3.
APART, LEAST = 6.0, 2e-4
FEW = 2  # parts, beyond one, that must have something to say
UNLIKE, DRIFTED = 0.02, 0.001  # contrasts of pictures, and of other frames, that are worth a message


@torch.no_grad()
def normalise_frame_gain(problem: Problem, least: float = 0.0) -> bool:
    """Divide the frames of stretched pictures by their contrasts, of mean one, as far as these are found by now.

    At a start, contrasts that all differ by less than `least` are left as they are, and what stands still is not in the
    prediction yet. Once a round has shown that all are alike, nothing more is done. Whether any was divided.
    """
    if not problem.stretched or problem.even:
        return False
    expected = problem.predict(problem.values())
    if least:
        expected = expected + temporal_mean(fixed_pattern_residual(problem), problem.precision.sign())
    frames = zip(problem.data, expected, problem.precision, strict=True)
    contrast = torch.cat([_slopes(*each, DEGREE)[0] for each in frames])
    contrast = (contrast / contrast.mean()).clamp(1 / LARGEST, LARGEST)
    if not (contrast - 1).abs().max() > least:
        return False
    whole = contrast * problem.contrast.flatten()
    if not least and (whole / whole.mean() - 1).abs().max() < ALIKE:
        contrast = 1 / problem.contrast.flatten()
        problem.even.fill_(True)
    divide_frame_gain(problem, contrast)
    return True


@torch.no_grad()
def detect_gain_drift(problem: Problem) -> bool:
    """Whether frames that are no pictures have contrasts, too: whether their parts agree on them.

    It is right only where scene and pattern have settled. Somebody who walks by is in one part or two.
    """
    if problem.stretched:
        return False
    slopes, weights = _parts(problem, problem.predict(problem.values()))
    each = slopes / slopes.mean(0) - 1
    found = (weights * each).sum(1) / weights.sum()
    spread = (weights * (each - found[:, None]).square()).sum(1) / weights.sum()
    free = weights.sum().square() / weights.square().sum() - 1  # of as many parts as count
    apart = (found.square() * free / spread).mean().sqrt()
    return bool(free > FEW and apart > APART and found.abs().max() > LEAST)


@torch.no_grad()
def correct_gain_drift(problem: Problem) -> None:
    """Divide the frames by what their contrasts are by now."""
    divide_frame_gain(problem, GainOffsetEvidence(problem, contrasts=True).contrasts())


def divide_frame_gain(problem: Problem, contrast: Tensor) -> None:
    """Divide the frames by contrasts (N,).

    About the middle of the samples, where a contrast that is not quite found changes the levels least.
    """
    contrast, middle = contrast.to(problem.data)[:, None, None, None], problem.middle()
    problem.data.sub_(middle).div_(contrast).add_(middle)
    problem.contrast.mul_(contrast)


def frame_gain_message(problem: Problem) -> list[str]:
    """Say so if contrasts differ."""
    apart = float((problem.contrast / problem.contrast.mean() - 1).abs().max())
    if problem.stretched and apart >= UNLIKE:
        return [
            f"the contrast of the frames differs by up to {apart:.0%}, as an automatic gain makes it: it is evened "
            "out. Record with a fixed gain, 14 or 16 bits, to measure"
        ]
    if not problem.stretched and apart >= DRIFTED:
        return [f"the camera's response drifts, by up to {apart:.1%} from frame to frame: it is evened out"]
    return []


def _parts(problem: Problem, expected: Tensor) -> tuple[Tensor, Tensor]:
    """Slopes of the parts of frames on what is expected of them, (N, parts), and how much each part tells, (parts,)."""
    h, w = problem.data.shape[-2:]
    step = max(round((h * w / ENOUGH) ** 0.5), 1)
    rows, columns = (
        [slice(side * i // PARTS, side * (i + 1) // PARTS, step) for i in range(PARTS)] for side in (h, w)
    )
    given = problem.data, expected, problem.precision
    parts = [[each[:, 0, y, x] for each in given] for y in rows for x in columns]
    found = [_slopes(frames, shown, weight, SLOW) for frames, shown, weight in parts]
    slopes, information = (torch.stack(each, 1) for each in zip(*found, strict=True))
    return slopes, information.mean(0)


def _slopes(frames: Tensor, expected: Tensor, weight: Tensor, degree: int) -> tuple[Tensor, Tensor]:
    """Of frames on what is expected of them, (N, h, w), by least squares, less what is slow; and how sure, (N,)."""
    y, x = (torch.linspace(-1, 1, side).to(frames).double() for side in frames.shape[1:])
    slow = torch.stack([(y**i)[:, None] * x**j for i in range(degree + 1) for j in range(degree + 1 - i)])
    design = torch.cat((expected[:, None].double(), slow.expand(len(frames), -1, -1, -1)), 1).flatten(2)
    weighted = design * weight.double().flatten(1)[:, None]
    normal = weighted @ design.mT
    normal.diagonal(dim1=1, dim2=2).mul_(1 + 1e-9)
    inverse, failed = torch.linalg.inv_ex(normal)
    told = (inverse @ (weighted @ frames.double().flatten(1)[..., None]))[:, 0, 0]
    known = (failed == 0) & (inverse[:, 0, 0] > 0)
    return told.where(known, 1.0), (1 / inverse[:, 0, 0]).where(known, 0.0)
