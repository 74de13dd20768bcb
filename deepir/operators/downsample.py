"""Integration of the scene over the detector's area."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register

#: Largest factor: beyond, the pixel's aperture removes all finer detail.
MAX_FACTOR = 8


@register("operator", "downsample")
class Downsample(Operator):
    """Mean over `factor` x `factor` blocks aligned on pixel edges; (N, C, Q h, Q w) -> (N, C, h, w).

    Saragadam et al. 2021, supplement, "Details about super resolution".
    """

    def __init__(self, *, factor: int = 2) -> None:
        super().__init__()
        if not 1 <= factor <= MAX_FACTOR:
            raise ValueError(f"factor must be 1 to {MAX_FACTOR}, not {factor}")
        self.factor = factor
        self.noise_gain = float(factor)  # the information of a sample is shared by factor² unknowns

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Both sides divided by `factor`; they must be multiples of it."""
        *head, height, width = x_shape
        if height % self.factor or width % self.factor:
            raise ValueError(f"downsample: {height} x {width} is no multiple of the factor {self.factor}")
        return (*head, height // self.factor, width // self.factor)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """Both sides times `factor`."""
        return (out_size[0] * self.factor, out_size[1] * self.factor)

    def forward(self, x: Tensor, **slots: Tensor) -> Tensor:
        """Average the blocks."""
        *head, height, width = self.out_shape(x.shape, x.shape[0])
        return x.reshape(*head, height, self.factor, width, self.factor).mean((-1, -3))

    def valid(self, mask: Tensor, **slots: Tensor) -> Tensor:
        """Blocks all of whose pixels are valid."""
        return -F.max_pool2d(-mask, self.factor)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Factor 3 on 2 frames."""
        generator = torch.Generator().manual_seed(0)
        return cls(factor=3), torch.rand(2, 1, 6, 9, generator=generator, dtype=torch.float64), {}
