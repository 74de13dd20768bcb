"""Samples at an end of the range: they do not say how much there is, but how much at least, or at most."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from deepir.arrays import Array
from deepir.arrays.statistics import robust_std
from deepir.effects.bad_pixels import DEAD_DEVIATION
from deepir.effects.effect import Effect, InitialEstimate
from deepir.estimation.residuals import fixed_pattern_residual, temporal_mean
from deepir.messages import Message
from deepir.problem import Problem
from deepir.registry import register

SATURATED_SHARE = 0.5  # of the samples of a place of the scene, if it is beyond the range
REPORTED_SHARE = 0.001  # of all samples; fewer are reported only if they bound the result
MIN_FRAMES_SEEN = 0.3  # frames that must show a pixel of the scene
NEIGHBOURHOOD = 7  # px, side of the square around a pixel of the scene
MIN_SATURATED_SHARE = 0.75  # of its neighbourhood, for a pixel within a saturated area


@torch.no_grad()
def bounded(problem: Problem, image: Tensor) -> tuple[Tensor, Tensor]:
    """The scene's image, at the bound or beyond where most samples that see it are cut off; and where, 1 or -1.

    A pixel that is cut off in all frames has an unknown offset: such pixels bound an area, but no single place.
    """
    where = torch.zeros_like(image, dtype=torch.int8)
    if problem.saturation is None:
        return image, where
    values, usable = problem.values(), (problem.precision > 0) & (problem.saturation == 0)
    _, seen = problem.backproject(values, usable)
    for sign in (1, -1):
        if (cut := problem.saturation == sign).any():
            bound, share = problem.backproject(values, cut)
            most = share > seen.clamp(min=MIN_FRAMES_SEEN)
            known, frames_seen = problem.backproject(values, cut & usable.any(0))
            is_known = frames_seen > MIN_FRAMES_SEEN
            area = (
                avg_pool2d(most.float(), NEIGHBOURHOOD, 1, NEIGHBOURHOOD // 2, count_include_pad=False)
                > MIN_SATURATED_SHARE
            )
            bound, most = torch.where(is_known, known, bound), most & (is_known | area)
            image = torch.where(most, sign * torch.maximum(sign * image, sign * bound), image)
            where[most] = sign
    return image, where


def clipping_message(problem: Problem, where: Array, frames: Array) -> list[str]:
    """A line if samples of frames (N, h, w) are cut off: where the result, on its grid, is not a value but a bound."""
    if problem.saturation is None:
        return []
    said = []
    for sign, name in ((1, "at least"), (-1, "at most")):
        cut, bounds = (problem.saturation[:, 0] == sign).cpu().numpy(), int((where == sign).sum())
        if bounds or cut.mean() > REPORTED_SHARE:
            said.append(
                f"{cut.mean():.2%} of the samples are cut off at {np.median(frames[cut]):g}: the scene is {name} as "
                f"much at {bounds} pixels"
            )
    return [Message("clipped-samples", "; ".join(said) + " ('clipped' in result.npz)")] if said else []


@register("effect", "saturation")
@dataclass(frozen=True)
class Saturation(Effect):
    """Samples at an end of the range: bounds of the scene, unless the pixel is stuck there."""

    @torch.no_grad()
    def reject(self, estimate: InitialEstimate) -> None:
        """Give up pixels cut off in all frames, though most of what others see there is not, and far from it."""
        problem = estimate.problem
        if estimate.step > 0 or problem.saturation is None:
            return
        cut, usable, values = problem.saturation != 0, problem.precision > 0, problem.values()
        those, all_of_them = (problem.backproject(values, each)[1] for each in (cut & usable, usable))
        share = those / all_of_them.clamp(min=1e-6)
        nothing = problem.predict(values | {"scene": torch.zeros_like(share)})
        lonely = problem.predict(values | {"scene": share}) - nothing < SATURATED_SHARE
        rest = fixed_pattern_residual(problem)
        far = problem.saturation * rest > DEAD_DEVIATION * robust_std(temporal_mean(rest, usable))
        live = ~(cut & lonely & far).all(0)
        problem.precision.mul_(live)
        problem.saturation.mul_(live)

    def initialise(self, problem: Problem) -> None:
        if problem.saturation is not None:  # a pixel rejected for its other samples is no bound either
            problem.saturation.mul_((problem.precision > 0) | (problem.saturation != 0).all(0))
