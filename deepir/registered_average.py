"""Registered average of the frames of a problem."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from deepir.problem import Problem, Values


class RegisteredAverage:
    """Weighted average of frames on the grid of the scene, `A' W (y - b) / A' W A 1` for the model `y = A x + b`.

    Terms that depend on A and W alone are computed once.

    Args:
        problem: Its operator and data.
        values: Values of the unknowns; the scene is not used.
        weights: Of the samples, (N, C, h, w); precisions relative to the largest if None.
    """

    def __init__(self, problem: Problem, values: Values, weights: Tensor | None = None) -> None:
        zero = torch.zeros_like(values["scene"])
        unit = problem.precision.amax().clamp(min=1e-30) if weights is None else 1
        self._problem, self._shape = problem, tuple(zero.shape)
        self._slots = {slot: values[name] for slot, name in problem.slots.items() if name in values}
        self._weights = (problem.precision if weights is None else weights) / unit
        #: Prediction for a zero scene, b.
        self.at_zero = problem.predict(values | {"scene": zero})
        ones = problem.predict(values | {"scene": zero + 1}) - self.at_zero
        #: Sum of the weights at each pixel of the scene, in frames, (S, C, H, W).
        self.weight = self._backproject(ones)

    def __call__(self, frames: Tensor) -> Tensor:
        """The average of frames (N, C, h, w), such as `y - b`, (S, C, H, W)."""
        return self._backproject(frames) / self.weight.clamp(min=1e-6)

    def _backproject(self, frames: Tensor) -> Tensor:
        # Without a warp, one prediction of its shape stands for all frames.
        each = (frames * self._weights).sum_to_size(self.at_zero.shape)
        return self._problem.operator.adjoint(each, self._shape, **self._slots)
