"""The registered average of a problem's frames, and what fills its holes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from deepir.problem import Problem, Values


class RegisteredAverage:
    """The average of frames on the scene's grid, by one motion, one sensor and one set of weights.

    With `y = A x + b`, and in W the `weights`, or else the precisions, as shares of the largest:
    `A' W (y - b) / A' W A 1`. What is of A and W alone is computed once: a start averages a burst many times.

    Args:
        problem: Its operator and data.
        values: Of its unknowns; the scene may be any.
        weights: (N, C, h, w), of the samples.
    """

    def __init__(self, problem: Problem, values: Values, weights: Tensor | None = None) -> None:
        zero = torch.zeros_like(values["scene"])
        unit = problem.precision.amax().clamp(min=1e-30) if weights is None else 1
        self._problem, self._shape = problem, tuple(zero.shape)
        self._slots = {slot: values[name] for slot, name in problem.slots.items() if name in values}
        self._weights = (problem.precision if weights is None else weights) / unit
        #: What the frames show of a scene of zero.
        self.at_zero = problem.predict(values | {"scene": zero})
        ones = problem.predict(values | {"scene": zero + 1}) - self.at_zero
        #: Weight of each pixel of the scene, in frames, (S, C, H, W).
        self.weight = self._carried(ones)

    def __call__(self, frames: Tensor) -> Tensor:
        """The average, (S, C, H, W), of `y - b`, or of what else the frames are to show of a scene."""
        return self._carried(frames) / self.weight.clamp(min=1e-6)

    def _carried(self, frames: Tensor) -> Tensor:
        # Without a warp, one prediction of its shape stands for all frames.
        each = (frames * self._weights).sum_to_size(self.at_zero.shape)
        return self._problem.operator.adjoint(each, self._shape, **self._slots)
