"""Position of the frames in the array of the scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from scipy.fft import next_fast_len
from torch import Tensor

from deepir.kernels.constants import MIN_DEPTH
from deepir.operators import Chain, Warp

#: Width of the canvas beyond the registered footprints, px.
CANVAS_MARGIN = 8


@dataclass(frozen=True)
class Geometry:
    """Sizes along the operator, and where frame 0 lies in the scene."""

    ratio: float  # scene px per detector px
    window: tuple[int, int, int, int]  # (y0, y1, x0, x1) of frame 0 in the scene's array

    def crop(self, scene: Any) -> Any:
        """The part of a scene (1, 1, H, W) that frame 0 shows, (h, w); of one for each frame, (N, h, w)."""
        y0, y1, x0, x1 = self.window
        pictures = scene[:, 0, y0:y1, x0:x1]
        return pictures[0] if len(pictures) == 1 else pictures


def locate_first_frame(chain: Chain, size: tuple[int, int], scene: tuple[int, int]) -> Geometry:
    """Geometry of a chain for frames of `size` (h, w) and a scene (H, W)."""
    stages = [stage for _, stage in chain.named()]
    first, later = stages[0], Chain(dict(chain.named()[1:]))
    rest = later if isinstance(first, Warp) else chain
    near, far = rest.in_size(size), rest.in_size((2 * size[0], 2 * size[1]))
    ratio = (far[0] - near[0]) / size[0]
    height, width = round(ratio * size[0]), round(ratio * size[1])
    y0, x0 = first.origin if isinstance(first, Warp) else (0, 0)
    inner = near if isinstance(first, Warp) else scene
    y0, x0 = y0 + (inner[0] - height) // 2, x0 + (inner[1] - width) // 2
    return Geometry(ratio, (int(y0), int(y0) + height, int(x0), int(x0) + width))


def footprint(
    motion: Tensor | None, size: tuple[int, int], ratio: float
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Canvas that contains the footprints of all frames, with a margin.

    Args:
        motion: (N, 3, 3) homographies, detector px; None for one frame at rest.
        size: (h, w) of a frame, scene px.
        ratio: Scene px per detector px.

    Returns:
        Size (H, W) and origin (y, x) of frame 0, scene px.
    """
    if motion is None:
        motion = torch.eye(3, dtype=torch.float64)[None]
    y, x = ((side - 1) / 2 for side in size)
    corners = torch.tensor([[-x, x, -x, x], [-y, -y, y, y], [1, 1, 1, 1]], dtype=torch.float64)
    moved = rescale_motion(motion, ratio).double() @ corners
    points = moved[:, :2] / moved[:, 2:].clamp(min=MIN_DEPTH) + corners.new_tensor([[x], [y]])
    low, high = points.amin((0, 2)), points.amax((0, 2))  # straight lines stay straight
    x0, y0 = (CANVAS_MARGIN + math.ceil(max(0.0, -float(v))) for v in low)
    x1, y1 = (
        CANVAS_MARGIN + math.ceil(max(float(v), side - 1))
        for v, side in zip(high, reversed(size), strict=True)
    )
    return (_fast_fft_length(y0 + y1 + 1), _fast_fft_length(x0 + x1 + 1)), (y0, x0)


@dataclass(frozen=True)
class Canvas:
    """The array of a scene that several data sets show: its size (H, W), and (y, x) of the first frames' centre, px."""

    size: tuple[int, int]
    centre: tuple[float, float]

    @classmethod
    def around(cls, warps: Sequence[Warp]) -> Canvas:
        """One that holds those of all warps, their frames concentric; the first one's pixels lie on its grid."""
        sides, centre = [], []
        for axis in (0, 1):
            before = [warp.origin[axis] + warp.size[axis] / 2 for warp in warps]
            behind = [warp.canvas[axis] - middle for warp, middle in zip(warps, before, strict=True)]
            centre.append(before[0] + math.ceil(max(before) - before[0]))
            sides.append(_fast_fft_length(math.ceil(centre[-1] + max(behind))))
        return cls((sides[0], sides[1]), (centre[0], centre[1]))

    def origin(self, size: tuple[int, int]) -> tuple[float, float]:
        """Index (y, x) of the first pixel of a frame of (h, w)."""
        return self.centre[0] - size[0] / 2, self.centre[1] - size[1] / 2


def _fast_fft_length(side: int) -> int:
    """An even length, a little more than `side`, whose Fourier transform is two or three times as fast."""
    return 2 * int(next_fast_len(-(-side // 2)))


def rescale_motion(motion: Tensor, ratio: float) -> Tensor:
    """Homographies in px of a grid that is `ratio` times finer, with the same centre."""
    s = torch.tensor([ratio, ratio, 1.0], dtype=motion.dtype)
    return motion * (s[:, None] / s)
