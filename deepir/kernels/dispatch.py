"""Whether the compiled loops compute, or their twins in torch."""

from __future__ import annotations

from torch import Tensor

#: False: the twins compute on the CPU too, so that tests can compare them with the loops.
ENABLED = True


def is_compiled(value: Tensor) -> bool:
    """Whether a compiled loop computes on a tensor: on the CPU alone."""
    return ENABLED and value.device.type == "cpu"
