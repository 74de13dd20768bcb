"""Whether the pattern that was found is a picture: then the motion was wrong, and the scene is in the pattern.

A sensor has columns, rows, pixels and something smooth, and what one pixel has says nothing of the one next but one.
Where the camera stands still while something moves, or moves by less than a pixel under a strong pattern, the motion
that is found may be of something else: what stands still is then the scene, and what is left may be its negative.
"""

from __future__ import annotations

import torch
from torch import Tensor

from deepir.noise.median import median
from deepir.operators import Sensor
from deepir.problem import Problem

DEGREE = 4  # of what is smooth
BESIDE = 2  # px: noise in the motion and the scene's interpolation reach one
OUTLIER = 4.0  # medians of the magnitudes at which these are cut off
#: Correlation of pixels so far apart from which a pattern is a picture; those that were found right have 0.08 at most.
ALIKE = 0.1
FAINT = 0.2  # of the scene: what is less may be of a sensor that was corrected with a scene in view


@torch.no_grad()
def ghost_message(problem: Problem) -> list[str]:
    """Say so if the pattern that was found is a picture."""
    stage, last = problem.operator.named()[-1]
    if not isinstance(last, Sensor) or not problem.closed_form():
        return []
    values = problem.values()
    flux = problem.flux(values)
    problem.eliminate(values, problem.closed_form(), flux=flux)
    gain, offset = (
        values[problem.slots[f"{stage}.{slot}"]].expand(1, 1, *flux.shape[-2:]) for slot in ("gain", "offset")
    )
    pattern, scene = (_rough(each[0, 0]) for each in (gain * flux.median() + offset, flux[:1]))
    if pattern.std() < FAINT * scene.std() or _alike(pattern) < ALIKE:
        return []
    return [
        "the fixed pattern that was found looks like a picture, as where the camera stands still and something else "
        "moves, or where the motion is not found: do not trust the scene. Move the camera between frames, by 3 to "
        "10 px in x and in y"
    ]


def _rough(image: Tensor) -> Tensor:
    """An image (h, w) less its lines and all that is smooth, outliers cut off."""
    image = image.double()
    image = image - image.median(1, keepdim=True).values
    image = image - image.median(0, keepdim=True).values
    y, x = (torch.linspace(-1, 1, side).to(image) for side in image.shape)
    smooth = [(y**i)[:, None] * x**j for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    terms = torch.stack(smooth, -1).flatten(0, 1)
    image = image - (terms @ torch.linalg.solve(terms.T @ terms, terms.T @ image.flatten())).reshape(
        image.shape
    )
    limit = OUTLIER * 1.5 * median(image.abs())
    image = image.clamp(-limit, limit)
    return image - image.mean()


def _alike(image: Tensor) -> Tensor:
    """Correlation of pixels that are `BESIDE` px apart, along rows and columns."""
    along = [
        (image.narrow(axis, BESIDE, side - BESIDE) * image.narrow(axis, 0, side - BESIDE)).mean()
        for axis, side in enumerate(image.shape)
    ]
    return (along[0] + along[1]) / 2 / image.square().mean().clamp(min=1e-300)
