"""Blur along the path that the camera takes during an exposure."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.operators.base import Shape
from deepir.operators.blur import Blur
from deepir.registry import register

LOBES = 3  # half the support of the interpolation kernel, px (Lanczos)


@register("operator", "path_blur")
class PathBlur(Blur):
    """The mean of the scene over a path of shifts in each frame, `y_k(p) = mean_i x(p + path_ki)`.

    The slot `path` is (N, 1, points, 2): shifts (x, y) in px, equally spaced in time. The input reaches `margin` px
    over the output's edges, three more than the longest shift; frames of longer ones are not valid. Between pixels the
    scene is interpolated by Lanczos' kernel.
    """

    example_shape = (1, 1, 10, 11)
    example_options: ClassVar = {"margin": 4, "points": 3}

    def __init__(self, *, margin: int = 16, points: int = 16) -> None:
        super().__init__(radius=margin)
        self.points = points

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`path`: (N, 1, points, 2)."""
        return {"path": (n_frames, 1, self.points, 2)}

    def fits(self, slot: str, wanted: Shape, found: Shape) -> bool:
        """A path of any number of points."""
        return len(found) == 4 and found[:2] == wanted[:2] and found[3] == 2

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """One frame for each path, smaller by the margin on each side."""
        return (n_frames, *super().out_shape(x_shape, n_frames)[1:])

    def forward(self, x: Tensor, *, path: Tensor) -> Tensor:  # type: ignore[override]
        """Convolve with each path's point-spread function."""
        return super().forward(x, psf=self.psf(path).to(x.dtype))

    def psf(self, path: Tensor) -> Tensor:
        """The point-spread function of each path, (N, 1, 2 margin + 1, 2 margin + 1), sum one."""
        axis = torch.arange(-self.radius, self.radius + 1, dtype=path.dtype, device=path.device)
        # Of a shift by +1 the convolution takes the sample at -1.
        offsets = (axis + path[:, 0, :, i, None] for i in (0, 1))
        # Lanczos' kernel, along either axis.
        across, down = (torch.where(x.abs() < LOBES, torch.sinc(x) * torch.sinc(x / LOBES), 0.0) for x in offsets)
        found = down.mT @ across
        return (found / found.sum((1, 2), keepdim=True))[:, None]

    def valid(self, mask: Tensor, *, path: Tensor) -> Tensor:  # type: ignore[override]
        """Pixels whose whole window is valid, of frames whose path is within the margin."""
        within = path.abs().amax((1, 2, 3)) <= self.radius - LOBES + 1e-4
        return super().valid(mask, psf=path) * within[:, None, None, None]
