"""Gains of whole frames, as an automatic gain control (AGC) sets them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from deepir.effects.effect import Effect
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.messages import Message
from deepir.problem import Problem
from deepir.registry import register

POLYNOMIAL_DEGREE = 4  # of the low-order part of a frame, which shading has too
MAX_CONTRAST = 3.0  # ratio of a frame's gain to the mean, either way
START_CONTRAST = 0.02  # least deviation of a gain that the initial estimate corrects
EQUAL_CONTRAST = 0.002  # largest deviation of gains that are called equal after a round
REPORTED_AGC, REPORTED_DRIFT = 0.02, 0.001  # deviation of gains that is reported: of AGC frames, of others


@torch.no_grad()
def normalise_frame_gain(problem: Problem, least: float = 0.0) -> bool:
    """Divide AGC frames by their gains, of mean one, estimated by regression on the prediction.

    Args:
        problem: Its data are divided, and its `contrast` multiplied.
        least: In the initial estimate, gains that all deviate by less are left; the fixed pattern, which is not in
            the prediction yet, is added to it.

    Returns:
        Whether frames were divided. Once a round has found all gains equal, none is.
    """
    if not problem.agc or problem.gains_are_equal:
        return False
    expected = problem.predict(problem.values())
    if least:
        expected = expected + temporal_mean(fixed_pattern_residual(problem), problem.precision.sign())
    frames = zip(problem.data, expected, problem.precision, strict=True)
    contrast = torch.cat([contrast_slopes(*each, POLYNOMIAL_DEGREE)[0] for each in frames])
    contrast = (contrast / contrast.mean()).clamp(1 / MAX_CONTRAST, MAX_CONTRAST)
    if not (contrast - 1).abs().max() > least:
        return False
    whole = contrast * problem.contrast.flatten()
    if not least and (whole / whole.mean() - 1).abs().max() < EQUAL_CONTRAST:
        contrast = 1 / problem.contrast.flatten()
        problem.gains_are_equal.fill_(True)
    problem.divide_frames(contrast)
    return True


def frame_gain_message(problem: Problem) -> list[str]:
    """A message if the gains of the frames differ."""
    apart = float((problem.contrast / problem.contrast.mean() - 1).abs().max())
    if problem.agc and apart >= REPORTED_AGC:
        return [
            Message(
                "contrast-varies",
                f"the contrast of the frames differs by up to {apart:.0%}, as an automatic gain makes it: it is evened "
                "out. Record with a fixed gain, 14 or 16 bits, to measure",
            )
        ]
    if not problem.agc and apart >= REPORTED_DRIFT:
        return [
            Message(
                "response-drift",
                f"the camera's response drifts, by up to {apart:.1%} from frame to frame: it is evened out",
            )
        ]
    return []


def contrast_slopes(frames: Tensor, expected: Tensor, weight: Tensor, degree: int) -> tuple[Tensor, Tensor]:
    """Least-squares slopes of frames (N, h, w) on their prediction, low-order parts aside; and their information."""
    y, x = (torch.linspace(-1, 1, side).to(frames).double() for side in frames.shape[1:])
    low_order = torch.stack(
        [(y**i)[:, None] * x**j for i in range(degree + 1) for j in range(degree + 1 - i)]
    )
    design = torch.cat((expected[:, None].double(), low_order.expand(len(frames), -1, -1, -1)), 1).flatten(2)
    weighted = design * weight.double().flatten(1)[:, None]
    normal = weighted @ design.mT
    normal.diagonal(dim1=1, dim2=2).mul_(1 + 1e-9)
    inverse, failed = torch.linalg.inv_ex(normal)
    slope = (inverse @ (weighted @ frames.double().flatten(1)[..., None]))[:, 0, 0]
    known = (failed == 0) & (inverse[:, 0, 0] > 0)
    return slope.where(known, 1.0), (1 / inverse[:, 0, 0]).where(known, 0.0)


@register("effect", "frame_gain")
@dataclass(frozen=True)
class FrameGain(Effect):
    """The gain of each frame, as an automatic gain control sets it."""

    def equalise(self, problem: Problem) -> bool:
        return normalise_frame_gain(problem, START_CONTRAST)

    def update(self, problem: Problem, *, settled: bool) -> bool:
        normalise_frame_gain(problem)
        return False

    def finish(self, problem: Problem) -> None:
        normalise_frame_gain(problem)

    def messages(self, problem: Problem, *, complete: bool) -> list[str]:
        return frame_gain_message(problem) if complete else []
