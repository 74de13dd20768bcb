"""Camera motion: the scene seen from each frame."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.registry import register

#: Entries of a homography are kept below `FAR`, and depths above `NEAR`, so that no coordinate overflows.
FAR, NEAR = 1e6, 1e-3


@register("operator", "warp")
class Warp(Operator):
    """Pull warp with bilinear interpolation, `frame_k(p) = scene(T_k p)`.

    `x` is (1, C, Hc, Wc), one canvas for all frames, or (N, C, Hc, Wc); the output is (N, C, h, w). The slot
    `motion` is (N, 3, 3), pull homographies in px with the origin at the frame's centre, or (N, h, w, 2), the
    point (x, y) that each pixel looks at, from the same origin. Outside the canvas the scene is its nearest
    edge pixel; `valid` is zero there.
    """

    place: Tensor

    def __init__(self, size: tuple[int, int], canvas: tuple[int, int], origin: tuple[int, int]) -> None:
        """`size` = (h, w), `canvas` = (Hc, Wc), `origin` = canvas index (y, x) of frame 0's first pixel."""
        super().__init__()
        self.size, self.canvas, self.origin = size, canvas, origin
        centre = [o + (side - 1) / 2 for o, side in zip(origin, size, strict=True)]
        # From centred px to grid_sample's units, align_corners=False: index i of s is (2 i + 1) / s - 1.
        (sy, ty), (sx, tx) = ((2 / s, (2 * c + 1) / s - 1) for c, s in zip(centre, canvas, strict=True))
        place = torch.tensor([[sx, 0, tx], [0, sy, ty], [0, 0, 1]], dtype=torch.float64)
        self.register_buffer("place", place, persistent=False)

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
        """Sample the canvas at the moved pixel centres.

        Raises:
            ValueError: `x` has another size than the canvas.
        """
        return self._sample(x, self._grid(motion, x.dtype))

    def valid(self, mask: Tensor, *, motion: Tensor) -> Tensor:  # type: ignore[override]
        """Samples whose neighbours are valid and in the canvas, to 1e-4 px."""
        grid = self._grid(motion, mask.dtype)
        height, width = self.canvas
        edge = grid.new_tensor([1 - (1 - 2e-4) / width, 1 - (1 - 2e-4) / height])
        inside = (grid.abs() <= edge).all(-1)[:, None]
        return (inside & (self._sample(mask, grid) > 1 - 1e-4)).to(mask.dtype)

    def _grid(self, motion: Tensor, dtype: torch.dtype) -> Tensor:
        """Where each pixel looks, (N, h, w, 2), in grid_sample's units; never NaN.

        A NaN crashes grid_sample's backward pass on the CPU (torch 2.13); a line search can produce one, and
        must see a bad loss instead.
        """
        motion = motion.nan_to_num(nan=FAR).clamp(-FAR, FAR)
        if motion.ndim == 4:
            return (motion * self.place.diagonal()[:2] + self.place[:2, 2]).to(dtype)
        return coords((self.place @ motion.double()).to(dtype), self.size)

    def _sample(self, x: Tensor, grid: Tensor) -> Tensor:
        if x.shape[-2:] != self.canvas:
            raise ValueError(f"warp: the canvas is {self.canvas}, but the scene {tuple(x.shape[-2:])}")
        x = x.expand(len(grid), -1, -1, -1)
        return F.grid_sample(x, grid, mode="bilinear", padding_mode="border", align_corners=False)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three frames of 6 x 7 px on a canvas of 11 x 12."""
        generator = torch.Generator().manual_seed(0)
        jitter = 0.05 * torch.rand(3, 3, 3, generator=generator, dtype=torch.float64)
        jitter[:, :2, 2] *= 20
        jitter[:, 2] *= 0.02
        jitter[:, 2, 2] = 0
        x = torch.rand(1, 1, 11, 12, generator=generator, dtype=torch.float64)
        return cls((6, 7), (11, 12), (2, 3)), x, {"motion": torch.eye(3, dtype=torch.float64) + jitter}


def coords(motion: Tensor, size: tuple[int, int]) -> Tensor:
    """The points `T_k p` of all pixel centres `p`, origin at the frame's centre; (N, 3, 3) -> (N, h, w, 2).

    In memory the planes of x and y follow each other: three times as fast as pairs, forth and back.
    """
    height, width = size
    y = torch.arange(height, dtype=motion.dtype, device=motion.device) - (height - 1) / 2
    x = torch.arange(width, dtype=motion.dtype, device=motion.device) - (width - 1) / 2
    t = motion[..., None, None]
    px, py, pz = (t[:, i, 0] * x + (t[:, i, 1] * y[:, None] + t[:, i, 2]) for i in range(3))
    nearness = pz.clamp(min=NEAR).reciprocal()
    return torch.stack((px * nearness, py * nearness), 1).permute(0, 2, 3, 1)
