"""What a scene gains from noise alone: more where the camera moves by whole pixels than by halves.

A frame that lies half way between the pixels of the scene hardly shows its shortest waves, so that the noise in these
stays unexplained. The joint optimum of scene and motion therefore lies nearer to whole pixels than the truth does. From
noise alone a wave gains half a nat times the share in it that the data decide, and not the prior: its degrees of
freedom (Hastie, Tibshirani 1990, "Generalized additive models"). With these given back, noise draws the motion nowhere.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection

import numpy as np
import torch
from torch import Tensor

from deepir.fields.motion import Motion
from deepir.operators import Warp
from deepir.optim.fourier_hessian import has_fourier_model
from deepir.problem import Problem

#: Under the weak prior, what holds the scene's gradients, as a share of what the frames hold its pixels by.
HELD = 0.001
WAVES, PLACES = 24, 5  # along each axis, of the spectrum and of the frame
#: Six times the weights of a spline's four coefficients, in powers of the shift beyond the second of them.
TAPS = ((1.0, -3.0, 3.0, -1.0), (4.0, 0.0, -6.0, 3.0), (1.0, 3.0, 3.0, -3.0), (0.0, 0.0, 0.0, 1.0))


def moves_with_scene(problem: Problem, group: Collection[str]) -> bool:
    """Whether the scene is free together with a motion of few parameters, and all of a frame is seen at once."""
    if not has_fourier_model(problem) or any(stage.temporal for _, stage in problem.operator.named()):
        return False
    motion = problem.slots[problem.slot(Warp, "motion")]
    return {"scene", motion} <= set(group) and isinstance(problem.fields[motion], Motion)


def degrees_of_freedom(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """Nats that a scene gains from the noise of frames of `size` (h, w) at motions (N, 3, 3)."""
    places, held, response = _fixed(size, motion.device)
    moved = motion.double() @ places
    shift = (moved[:, :2] / moved[:, 2:] - places[:2]).permute(2, 1, 0)  # (places, x or y, N)
    t = shift - shift.floor()
    square, cube = t * t, t * t * t
    powers = torch.ones_like(t), t, square, cube, square * square, square * cube, cube * cube
    along_x, along_y = (torch.stack(powers, -1) @ response).unbind(1)
    seen = along_y.mT @ along_x / len(motion)
    return 0.5 * math.prod(size) * (seen / (seen + held)).mean()


@functools.lru_cache(maxsize=8)  # a solve asks at each evaluation
def _fixed(size: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Places of the frame (3, K); what holds the waves, (WAVES, WAVES); the spline's squared response to them.

    The latter, (7, WAVES), is of a cubic B-spline sampled at a shift, in powers of this.
    """
    waves = (torch.arange(WAVES, dtype=torch.float64) + 0.5) * (math.pi / WAVES)
    y, x = (side * torch.linspace(-0.4, 0.4, PLACES, dtype=torch.float64) for side in size)
    places = torch.cartesian_prod(x, y, x.new_ones(1)).T
    held = HELD * (4 - 2 * waves.cos() - 2 * waves.cos()[:, None])
    response = waves.new_zeros(7, WAVES)
    for i, j in itertools.product(range(4), repeat=2):
        product = torch.from_numpy(np.convolve(TAPS[i], TAPS[j])) / 36
        response += product[:, None] * ((i - j) * waves).cos()
    return places.to(device), held.to(device), response.to(device)
