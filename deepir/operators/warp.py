"""Camera motion: the scene seen from each frame."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register


@register("operator", "warp")
class Warp(Operator):
    """Pull warp with bilinear interpolation, `frame_k(p) = scene(T_k p)`.

    `x` is (1, C, Hc, Wc), one canvas for all frames, or (N, C, Hc, Wc); the output is (N, C, h, w). The slot
    `motion` is (N, 3, 3), pull homographies in px with the origin at the frame's centre, or (N, h, w, 2), the
    point (x, y) that each pixel looks at, from the same origin. Outside the canvas the scene is its nearest edge
    pixel; `valid` is zero there.
    """

    def __init__(self, size: tuple[int, int], canvas: tuple[int, int], origin: tuple[float, float]) -> None:
        """`size` = (h, w) of a frame, `canvas` = (Hc, Wc), `origin` = canvas index (y, x) of frame 0's pixel 0, 0."""
        super().__init__()
        self.size, self.canvas, self.origin = size, canvas, origin

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`motion`: (N, 3, 3)."""
        return {"motion": (n_frames, 3, 3)}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, h, w)."""
        return (n_frames, x_shape[1], *self.size)

    def in_size(self, out_size: tuple[int, int]) -> tuple[int, int]:
        """The canvas."""
        return self.canvas

    def forward(self, x: Tensor, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """Sample the canvas at the moved pixel centres."""
        return sample(x, self.indices(motion))

    def indices(self, motion: Tensor) -> Tensor:
        """Canvas index (x, y) that each pixel of each frame looks at, (N, h, w, 2)."""
        points = motion if motion.ndim == 4 else coords(motion, self.size)
        height, width = self.size
        shift = points.new_tensor([(width - 1) / 2 + self.origin[1], (height - 1) / 2 + self.origin[0]])
        return points + shift

    def valid(self, mask: Tensor, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """Samples whose four neighbours are valid and in the canvas."""
        index = self.indices(motion.to(mask.dtype))
        inside = (index >= 0).all(-1) & (index <= index.new_tensor([self.canvas[1] - 1, self.canvas[0] - 1])).all(-1)
        return inside[:, None] * (sample(mask, index) > 1 - 1e-4).to(mask.dtype)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three frames of 6 x 7 px on a canvas of 11 x 12."""
        generator = torch.Generator().manual_seed(0)
        jitter = 0.05 * torch.rand(3, 3, 3, generator=generator, dtype=torch.float64)
        jitter[:, :2, 2] *= 20
        jitter[:, 2] *= 0.02
        jitter[0], jitter[:, 2, 2] = 0, 0
        motion = torch.eye(3, dtype=torch.float64) + jitter
        x = torch.rand(1, 1, 11, 12, generator=generator, dtype=torch.float64)
        return cls((6, 7), (11, 12), (2, 3)), x, {"motion": motion}


def coords(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """The points `T_k p` of all pixel centres `p`, origin at the frame's centre; (N, 3, 3) -> (N, h, w, 2)."""
    height, width = size
    y = torch.arange(height, dtype=motion.dtype, device=motion.device) - (height - 1) / 2
    x = torch.arange(width, dtype=motion.dtype, device=motion.device) - (width - 1) / 2
    t = motion[..., None, None]
    px, py, pz = (t[:, i, 0] * x + (t[:, i, 1] * y[:, None] + t[:, i, 2]) for i in range(3))
    return torch.stack((px / pz, py / pz), -1)


def sample(x: Tensor, index: Tensor) -> Tensor:
    """Bilinear values of `x` (1 or N, C, H, W) at array indices (x, y), (N, h, w, 2); edges are extended."""
    height, width = x.shape[-2:]
    # A coordinate that is NaN crashes torch's backward pass on the CPU, and a huge one overflows its integers;
    # a line search can produce either, and must see a bad loss instead.
    index = index.nan_to_num(nan=math.inf).clamp(-8.0 * width, 8.0 * width + 8.0 * height)
    half = index.new_tensor([width / 2, height / 2])
    grid = (index + 0.5) / half - 1
    frames, channels = grid.shape[0], x.shape[1]
    if x.shape[0] == 1 and frames > 1:
        # One canvas seen by all frames: the frames stacked as one tall image spare N copies of the canvas.
        tall = grid.reshape(1, -1, grid.shape[2], 2)
        out = F.grid_sample(x, tall, mode="bilinear", padding_mode="border", align_corners=False)
        return out.reshape(channels, frames, *grid.shape[1:3]).transpose(0, 1)
    return F.grid_sample(x, grid, mode="bilinear", padding_mode="border", align_corners=False)
