"""Where a kernel runs, and constants of kernels."""

from __future__ import annotations

from torch import Tensor

#: Largest entry of a homography: beyond, coordinates overflow in float32.
MAX_ENTRY = 1e6
#: Smallest depth of a projected point.
MIN_DEPTH = 1e-3
#: Determinants that are multiplied before one logarithm is taken.
DETERMINANTS_PER_LOG = 8


#: False: the twins compute on the CPU too, so that tests can compare them with the loops.
ENABLED = True


def is_compiled(value: Tensor) -> bool:
    """Whether a compiled loop computes on a tensor: on the CPU alone."""
    return ENABLED and value.device.type == "cpu"
