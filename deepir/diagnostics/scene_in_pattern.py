"""Whether the pattern that was found is a picture: then the motion was wrong, and the scene is in the pattern.

A sensor has columns, rows, pixels and something smooth, and what one pixel has says nothing of the one next but one.
Where the camera stands still while something moves, or moves by less than a pixel under a strong pattern, the motion
that is found may be of something else: what stands still is then the scene, and what is left may be its negative. Dust
on a window, a bonnet, the corners that a lens leaves dark look like pictures, too, but there the motion explains the
frames far better than rest does.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.arrays.samples import autocorrelation
from deepir.arrays.statistics import MAD_TO_SIGMA, median
from deepir.diagnostics.motion_evidence import MIN_MOTION_NATS, motion_nats
from deepir.messages import Message
from deepir.operators import Sensor, Warp
from deepir.optim.low_order_model import polynomials
from deepir.problem import Problem

PATTERN_DISTANCE = 2  # px: noise in the motion and the scene's interpolation reach one
PATTERN_CLIP_SIGMAS = 4.0  # robust standard deviations at which values are cut off
#: Correlation of pixels so far apart from which a pattern is a picture; those that were found right have 0.08 at most.
MIN_PATTERN_CORRELATION = 0.1
MIN_PATTERN_CONTRAST = (
    0.2  # of the scene: what is less may be of a sensor that was corrected with a scene in view
)


@torch.no_grad()
def scene_in_pattern_message(problem: Problem) -> list[str]:
    """Say so if the pattern that was found is a picture."""
    stage, last = problem.operator.named()[-1]
    if not isinstance(last, Sensor) or not problem.closed_form() or not problem.slot(Warp, "motion"):
        return []
    values = problem.values()
    flux = problem.flux(values)
    problem.eliminate(values, problem.closed_form(), flux=flux)
    gain, offset = (values[problem.slots[f"{stage}.{slot}"]] for slot in ("gain", "offset"))
    shown = (gain * flux.median() + offset).expand_as(flux[:1])
    pattern, scene = (_rough(each[0, 0], problem.alive()) for each in (shown, flux))
    if (
        pattern.std() < MIN_PATTERN_CONTRAST * scene.std()
        or _alike(pattern, problem.alive()) < MIN_PATTERN_CORRELATION
        or motion_nats(problem) > MIN_MOTION_NATS
    ):
        return []
    return [
        Message(
            "scene-in-pattern",
            "the fixed pattern that was found looks like a picture, as where the camera stands still and something "
            "else moves, or where the motion is not found: do not trust the scene. Move the camera between frames, by "
            "3 to 10 px in x and in y",
        )
    ]


def _rough(image: Tensor, good: Tensor) -> Tensor:
    """An image (h, w) less its lines and all that is smooth, outliers cut off; zero where it is not good."""
    image = image.double()
    image = image - image.median(1, keepdim=True).values
    image = image - image.median(0, keepdim=True).values
    image = image - polynomials(*image.shape, image.device).project(image)
    limit = PATTERN_CLIP_SIGMAS * MAD_TO_SIGMA * median(image.abs())
    return image.clamp(-limit, limit) * good


def _alike(image: Tensor, good: Tensor) -> float:
    """Correlation of pixels that are `PATTERN_DISTANCE` px apart, along rows and columns."""
    found = autocorrelation(*(each.cpu().numpy() for each in (image, image, good)))
    middle = len(found) // 2
    return float(found[middle, middle + PATTERN_DISTANCE] + found[middle + PATTERN_DISTANCE, middle]) / 2
