"""Models of the motion of frames: shifts to homographies, over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from deepir.operators import Chain, Warp
from deepir.operators.warp import fast_fft_length, project_pixels

PARAMETERS = {"shift": 2, "rigid": 3, "affine": 6, "homography": 8}  # number of parameters of a frame, by model
AUTO = "auto"  # model name: rigid, or homographies if the frames are distorted


@dataclass(frozen=True)
class Geometry:
    """Sizes along the operator, and where frame 0 lies in the scene."""

    ratio: tuple[float, float]  # scene px per detector px, down and across
    window: tuple[int, int, int, int]  # (y0, y1, x0, x1) of frame 0 in the scene's array

    def crop(self, scene: Any) -> Any:
        """The part of a scene (1, 1, H, W) that frame 0 shows, (h, w); of one for each frame, (N, h, w)."""
        y0, y1, x0, x1 = self.window
        pictures = scene[:, 0, y0:y1, x0:x1]
        return pictures[0] if len(pictures) == 1 else pictures


def locate_first_frame(chain: Chain, size: tuple[int, int], scene: tuple[int, int]) -> Geometry:
    """Geometry of a chain for frames of `size` (h, w) and a scene (H, W)."""
    (_, first), *later = chain.named()
    rest = Chain(dict(later)) if isinstance(first, Warp) else chain
    near, far = rest.in_size(size), rest.in_size((2 * size[0], 2 * size[1]))
    if near == far:  # the data are no pictures of the scene, but measurements of it, such as those of a single pixel
        return Geometry((1.0, 1.0), (0, scene[0], 0, scene[1]))
    height, width = (twice - once for twice, once in zip(far, near, strict=True))
    (y0, x0), inner = (first.origin, near) if isinstance(first, Warp) else ((0, 0), scene)
    y0, x0 = y0 + (inner[0] - height) // 2, x0 + (inner[1] - width) // 2
    return Geometry((height / size[0], width / size[1]), (int(y0), int(y0) + height, int(x0), int(x0) + width))


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
            sides.append(fast_fft_length(math.ceil(centre[-1] + max(behind))))
        return cls((sides[0], sides[1]), (centre[0], centre[1]))

    def origin(self, size: tuple[int, int]) -> tuple[float, float]:
        """Index (y, x) of the first pixel of a frame of (h, w)."""
        return self.centre[0] - size[0] / 2, self.centre[1] - size[1] / 2


def displacement_at(motion: Tensor, at: Tensor) -> Tensor:
    """Displacement (x, y) of the point `at` (2,) in each frame, (N, 2) px; of the nearest pixel for sampling points."""
    if motion.ndim == 3:
        moved = motion @ torch.cat((at, at.new_ones(1)))
        return moved[:, :2] / moved[:, 2:] - at
    column, row = (round(float(c) + (side - 1) / 2) for c, side in zip(at, motion.shape[2:0:-1], strict=True))
    return displacements(motion)[:, :, row, column]


def displacements(points: Tensor) -> Tensor:
    """Displacements (x, y) of all pixels, px: (N, h, w, 2) -> (N, 2, h, w)."""
    still = project_pixels(torch.eye(3).to(points)[None], (points.shape[1], points.shape[2]))
    return (points - still).permute(0, 3, 1, 2)


def homographies(motion: Tensor) -> Tensor:
    """Homographies (N, 3, 3): the motion itself, or a depth-weighted least-squares fit to sampling points."""
    if motion.ndim == 3:
        return motion
    size = (motion.shape[1], motion.shape[2])
    x, y = project_pixels(torch.eye(3).to(motion).double()[None], size)[0].flatten(0, 1).T
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    found = []
    for u, v in motion.double().flatten(1, 2).mT:
        of_u = torch.stack((x, y, one, zero, zero, zero, -u * x, -u * y), 1)
        of_v = torch.stack((zero, zero, zero, x, y, one, -v * x, -v * y), 1)
        unit = x.new_tensor([1, 1, 1, 1, 1, 1, 1 / size[0] ** 2, 1 / size[1] ** 2])
        rows = torch.cat((of_u, of_v)) * unit
        solved = torch.linalg.lstsq(rows, torch.cat((u, v))[:, None], driver="gels").solution[:, 0] * unit
        found.append(torch.cat((solved, one[:1])).reshape(3, 3))
    return torch.stack(found).to(motion)


def identity(n: int) -> Tensor:
    """`n` identity motions, (n, 3, 3) float64."""
    return torch.eye(3, dtype=torch.float64).repeat(n, 1, 1)


def relative(motion: Tensor, to: int = 0) -> Tensor:
    """Motions `(N, 3, 3)` relative to one of them."""
    return normalised(torch.linalg.inv(motion[to]) @ motion)


def normalised(motion: Tensor) -> Tensor:
    """The same homographies with `T[2, 2] = 1`."""
    return motion / motion[..., 2:, 2:]


def transform_points(motion: Tensor, points: Tensor) -> Tensor:
    """Points `(x, y, 1)`, `(3, M)`, moved by homographies `(N, 3, 3)`: x and y `(N, 2, M)`."""
    at = motion @ points
    return at[:, :2] / at[:, 2:]


def rotation(angle: Tensor) -> Tensor:
    """Rotations `(..., 3, 3)` by angles `(...)` in radians; positive turns +x towards +y."""
    cos, sin, zero, one = angle.cos(), angle.sin(), torch.zeros_like(angle), torch.ones_like(angle)
    return torch.stack((cos, -sin, zero, sin, cos, zero, zero, zero, one), -1).unflatten(-1, (3, 3))


def nearest_angle(motion: Tensor) -> Tensor:
    """Angles in radians of the rotations that are nearest to homographies `(..., 3, 3)`."""
    return torch.atan2(motion[..., 1, 0] - motion[..., 0, 1], motion[..., 0, 0] + motion[..., 1, 1])


def nearest_rigid(motion: Tensor) -> Tensor:
    """The translation of homographies `(..., 3, 3)` with `T[2, 2] = 1`, and the nearest rotation."""
    out = rotation(nearest_angle(motion))
    out[..., :2, 2] = motion[..., :2, 2]
    return out


def generators(model: str, points: Tensor, size: float) -> tuple[Tensor, Tensor]:
    """Derivative of a moved point with respect to the model's parameters, at the identity.

    `points` are x and y, `(2, ...)`; `size` (px) scales the parameters to pixels at the frame's edge, which keeps the
    normal equations well conditioned. Returns dx and dy, each `(P, ...)`.
    """
    x, y = points / size
    one, zero = torch.ones_like(x), torch.zeros_like(x)
    columns = {"shift": [(one, zero), (zero, one)], "rigid": [(one, zero), (zero, one), (-y, x)]}.get(
        model, [(one, zero), (zero, one), (x, zero), (y, zero), (zero, x), (zero, y)]
    )
    if model == "homography":
        columns = [*columns, (-x * x, -x * y), (-x * y, -y * y)]
    return torch.stack([c[0] for c in columns]), torch.stack([c[1] for c in columns])


def increment(model: str, delta: Tensor, size: float) -> Tensor:
    """The motions `(B, 3, 3)` of small parameters `(B, P)`, in the order and scale of `generators`."""
    x, y = delta[:, 0], delta[:, 1]
    zero, one = torch.zeros_like(x), torch.ones_like(x)
    a, b, c, d, g, h = one, zero, zero, one, zero, zero
    if model == "rigid":
        angle = delta[:, 2] / size
        a, c = angle.cos(), angle.sin()
        b, d = -c, a
    elif model in ("affine", "homography"):
        linear = delta[:, 2:6] / size
        a, b, c, d = 1 + linear[:, 0], linear[:, 1], linear[:, 2], 1 + linear[:, 3]
    if model == "homography":
        g, h = (delta[:, 6:] / size**2).unbind(1)
    return torch.stack((a, b, x, c, d, y, g, h, one), -1).unflatten(-1, (3, 3))


def parameters_of(model: str, motion: Tensor, size: float) -> Tensor:
    """The inverse of `increment`: parameters `(B, P)` of motions `(B, 3, 3)`, projected onto the model."""
    found = [motion[:, :2, 2]]
    if model == "rigid":
        found.append(size * nearest_angle(motion)[:, None])
    elif model in ("affine", "homography"):
        linear = motion[:, :2, :2] - torch.eye(2, dtype=motion.dtype, device=motion.device)
        found.append(size * linear.flatten(1))
    if model == "homography":
        found.append(size**2 * motion[:, 2, :2])
    return torch.cat(found, 1)
