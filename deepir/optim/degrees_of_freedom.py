"""Effective degrees of freedom of the scene as a function of sub-pixel motion.

A frame half way between the pixels of the scene hardly shows the shortest waves, so their noise is not fitted. The
joint optimum of scene and motion is therefore biased towards whole pixels. Fitted noise lowers the objective by half a
nat per effective degree of freedom of a wave: the fraction of it that the data determine, not the prior. Adding this
back removes the bias.

Source: Hastie and Tibshirani 1990, "Generalized additive models", section 3.5.
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

#: Weight of the scene's squared gradient under the weak prior, relative to the precision of a frame.
GRADIENT_WEIGHT = 0.001
#: Frequencies along each axis of the spectrum.
N_FREQUENCIES = 24
#: Positions along each axis of the frame.
N_POSITIONS = 5
#: Polynomials in the sub-pixel shift: six times the weights of the four coefficients of a cubic B-spline.
SPLINE_POLYNOMIALS = (
    (1.0, -3.0, 3.0, -1.0),
    (4.0, 0.0, -6.0, 3.0),
    (1.0, 3.0, 3.0, -3.0),
    (0.0, 0.0, 0.0, 1.0),
)


def is_joint_with_motion(problem: Problem, group: Collection[str]) -> bool:
    """Whether scene and a parametric motion are fitted jointly, with all rows of a frame exposed at once."""
    if not has_fourier_model(problem) or any(stage.temporal for _, stage in problem.operator.named()):
        return False
    motion = problem.slots[problem.slot(Warp, "motion")]
    return {"scene", motion} <= set(group) and isinstance(problem.fields[motion], Motion)


def degrees_of_freedom(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """Half the effective degrees of freedom of the scene, nats.

    Args:
        motion: (N, 3, 3) homographies, px.
        size: (h, w) of a frame.

    Returns:
        A scalar with a gradient in the motion.
    """
    positions, prior, response = _tables(size, motion.device)
    moved = motion.double() @ positions
    shift = (moved[:, :2] / moved[:, 2:] - positions[:2]).permute(2, 1, 0)  # (positions, x or y, N)
    t = shift - shift.floor()
    square, cube = t * t, t * t * t
    powers = torch.ones_like(t), t, square, cube, square * square, square * cube, cube * cube
    along_x, along_y = (torch.stack(powers, -1) @ response).unbind(1)
    information = along_y.mT @ along_x / len(motion)
    return 0.5 * math.prod(size) * (information / (information + prior)).mean()


@functools.lru_cache(maxsize=8)  # a solve asks at each evaluation
def _tables(size: tuple[int, int], device: torch.device) -> tuple[Tensor, Tensor, Tensor]:
    """Tables that do not depend on the motion.

    Returns:
        Homogeneous positions in the frame, (3, K); weight of the prior on each wave, (N_FREQUENCIES, N_FREQUENCIES);
        squared response of a shifted cubic B-spline to each wave as a polynomial in the shift, (7, N_FREQUENCIES).
    """
    waves = (torch.arange(N_FREQUENCIES, dtype=torch.float64) + 0.5) * (math.pi / N_FREQUENCIES)
    y, x = (side * torch.linspace(-0.4, 0.4, N_POSITIONS, dtype=torch.float64) for side in size)
    positions = torch.cartesian_prod(x, y, x.new_ones(1)).T
    prior = GRADIENT_WEIGHT * (4 - 2 * waves.cos() - 2 * waves.cos()[:, None])
    response = waves.new_zeros(7, N_FREQUENCIES)
    for i, j in itertools.product(range(4), repeat=2):
        product = torch.from_numpy(np.convolve(SPLINE_POLYNOMIALS[i], SPLINE_POLYNOMIALS[j])) / 36
        response += product[:, None] * ((i - j) * waves).cos()
    return positions.to(device), prior.to(device), response.to(device)
