"""Whether the frames say that the motion which was found is theirs; else a correction by it may be worse than none."""

from __future__ import annotations

import torch

from deepir.arrays.samples import Array
from deepir.diagnostics.repeating_scene import scene_period
from deepir.diagnostics.residual_correlation import (
    MIN_RESIDUAL_CORRELATION,
    RESIDUAL_CLIP_SIGMAS,
    residual_correlation,
)
from deepir.messages import Message
from deepir.operators import Sensor, Warp
from deepir.operators.motion_models import identity
from deepir.problem import Problem
from deepir.registration.motion_search import search_level
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import log_likelihood_ratio

#: Nats by which the motion makes each sample likelier than rest; 0.1 at most where it was wrong.
MIN_MOTION_NATS = 0.3
#: The same before a scene that repeats itself: if all frames register, and if fewer than a share do, since frames of
#: another phase of the period are then left out, and the others rest.
MIN_NATS_PERIODIC, MIN_NATS_PERIODIC_FEW, MIN_REGISTERED = 0.5, 1.2, 0.7


@torch.no_grad()
def motion_nats(problem: Problem) -> float:
    """Nats by which the motion of whole frames makes each sample likelier than rest; infinite for other motions."""
    motion = problem.field_of(problem.slot(Warp, "motion"))().double().cpu()
    if motion.shape != (len(problem.data), 3, 3):
        return float("inf")
    flat, weight = preprocess(problem.data[:, 0].cpu(), ~problem.alive().cpu())
    return log_likelihood_ratio(search_level(flat, weight), identity(len(motion)), motion)


@torch.no_grad()
def doubtful_motion(problem: Problem, frames: Array, usable: Array, used: Array) -> list[str]:
    """Say why the motion is not to be trusted; [] where it is.

    Args:
        problem: Solved.
        frames: All of the burst, (N, h, w).
        usable: Samples that count, same shape, bool.
        used: Frames that registered, (N,) bool.
    """
    if not isinstance(problem.operator.named()[-1][1], Sensor) or not problem.slot(Warp, "motion"):
        return []
    period = scene_period(frames, usable)
    if period is not None:
        least = MIN_NATS_PERIODIC if used.mean() >= MIN_REGISTERED else MIN_NATS_PERIODIC_FEW
        if motion_nats(problem) < least:
            return [
                Message(
                    "scene-repeats",
                    f"the scene repeats itself, by about {period:.0f} px, so that frames match at many displacements, "
                    "and the motion that was found explains them little better than rest",
                )
            ]
    values = problem.values()
    left = problem.data - problem.predict(values)
    scaled = (left * problem.precision.sqrt()).clamp(-RESIDUAL_CLIP_SIGMAS, RESIDUAL_CLIP_SIGMAS)
    if len(left) < 3 or residual_correlation(scaled, problem.precision) < MIN_RESIDUAL_CORRELATION:
        return []
    name = problem.operator.named()[-1][0]
    gain, offset = (values[problem.slots[f"{name}.{slot}"]] for slot in ("gain", "offset"))
    pattern = gain * problem.flux(values).median() + offset
    counts = problem.precision > 0
    if left[counts].std() < pattern.expand_as(left[:1])[counts.any(0, keepdim=True)].std():
        return []
    if motion_nats(problem) > MIN_MOTION_NATS:
        return []
    return [
        Message(
            "motion-not-trusted",
            "the frames do not show one scene that moves: the motion that was found explains them no better than rest, "
            "and leaves more than the pattern",
        )
    ]
