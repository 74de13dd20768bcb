"""Detect a scene in the estimated fixed pattern, the result of a wrong motion.

Columns, rows, pixels and shading of a sensor are uncorrelated at two pixels' distance. If the camera rests while an
object moves, or moves by less than a pixel under a strong pattern, the estimated motion may belong to something else,
and the scene is attributed to the pattern. Dust on a window or vignetting look like pictures, too, but then the motion
explains the frames far better than rest does.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.autocorrelation import autocorrelation
from deepir.arrays.statistics import MAD_TO_SIGMA, median
from deepir.operators import Sensor, Warp
from deepir.operators.motion_models import identity
from deepir.optim.low_order_model import polynomials
from deepir.problem import Problem
from deepir.registration.motion_search import search_level
from deepir.registration.preprocess import preprocess
from deepir.registration.robust_score import log_likelihood_ratio

#: Distance at which the correlation is taken, px: noise of the motion and interpolation reach one.
PATTERN_DISTANCE = 2
#: Value at which the pattern is clipped, robust standard deviations.
PATTERN_CLIP_SIGMAS = 4.0
#: Correlation from which a pattern is a picture; 0.08 at most in patterns that were right.
MIN_PATTERN_CORRELATION = 0.1
#: Contrast of the pattern relative to the scene; less may come from a correction with a scene in view.
MIN_PATTERN_CONTRAST = 0.2
#: Log-likelihood ratio of motion against rest that excludes a wrong motion, nats per sample; 0.1 at most in wrong ones.
MIN_MOTION_NATS = 0.3


@torch.no_grad()
def scene_in_pattern_message(problem: Problem) -> list[str]:
    """Warning for a pattern that contains the scene; [] otherwise."""
    stage, last = problem.operator.named()[-1]
    if not isinstance(last, Sensor) or not problem.closed_form() or not problem.slot(Warp, "motion"):
        return []
    values = problem.values()
    flux = problem.flux(values)
    problem.eliminate(values, problem.closed_form(), flux=flux)
    gain, offset = (values[problem.slots[f"{stage}.{slot}"]] for slot in ("gain", "offset"))
    shown = (gain * flux.median() + offset).expand_as(flux[:1])
    pattern, scene = (_high_pass(each[0, 0], problem.alive()) for each in (shown, flux))
    if (
        pattern.std() < MIN_PATTERN_CONTRAST * scene.std()
        or _correlation(pattern, problem.alive()) < MIN_PATTERN_CORRELATION
        or _motion_is_certain(problem)
    ):
        return []
    return [
        "the fixed pattern that was found looks like a picture, as where the camera stands still and something else "
        "moves, or where the motion is not found: do not trust the scene. Move the camera between frames, by 3 to "
        "10 px in x and in y"
    ]


def _motion_is_certain(problem: Problem) -> bool:
    """Whether the estimated homographies explain the frames clearly better than rest."""
    motion = problem.field_of(problem.slot(Warp, "motion"))().double().cpu()
    if motion.shape != (len(problem.data), 3, 3):
        return False
    flat, weight = preprocess(problem.data[:, 0].cpu(), ~problem.alive().cpu())
    return log_likelihood_ratio(search_level(flat, weight), identity(len(motion)), motion) > MIN_MOTION_NATS


def _high_pass(image: Tensor, good: Tensor) -> Tensor:
    """High-pass filtered image (h, w) without lines, outliers clipped; zero where not good."""
    image = image.double()
    image = image - image.median(1, keepdim=True).values
    image = image - image.median(0, keepdim=True).values
    image = image - polynomials(*image.shape, image.device).project(image)
    limit = PATTERN_CLIP_SIGMAS * MAD_TO_SIGMA * median(image.abs())
    return image.clamp(-limit, limit) * good


def _correlation(image: Tensor, good: Tensor) -> float:
    """Mean correlation at `PATTERN_DISTANCE` along rows and columns."""
    found = autocorrelation(*(each.cpu().numpy() for each in (image, image, good)))
    middle = len(found) // 2
    return float(found[middle, middle + PATTERN_DISTANCE] + found[middle + PATTERN_DISTANCE, middle]) / 2
