"""The median of many numbers; torch takes five times as long."""

from __future__ import annotations

import torch
from torch import Tensor

MAD = 1.4826  # standard deviation of a Gaussian per median absolute deviation
MANY = 5_000


def median(values: Tensor) -> float:
    """The lower one of two middle values, as torch has it; NaN of none. Values may not be NaN."""
    if values.device.type != "cpu" or values.dtype != torch.float32 or values.numel() < MANY:
        return float(values.median())
    from deepir.kernels.compile import parallel_for
    from deepir.kernels.median import median as of_bits

    found = torch.empty(1)
    parallel_for(of_bits, 1, values.contiguous().flatten().view(torch.int32), found.view(torch.int32))
    return float(found)


def robust_std(values: Tensor) -> float:
    """Standard deviation of the bulk of the values."""
    return MAD * median((values - median(values)).abs())
