"""Motion models: homographies about the frame's centre, updated by composition."""

from __future__ import annotations

import torch
from torch import Tensor

#: Number of parameters of a frame, by model.
PARAMETERS = {"shift": 2, "rigid": 3, "affine": 6, "homography": 8}
#: Model name: rigid, or homographies if the frames are distorted.
AUTO = "auto"


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
    out = angle.new_zeros(*angle.shape, 3, 3, dtype=torch.float64)
    out[..., 0, 0] = out[..., 1, 1] = angle.cos()
    out[..., 1, 0] = angle.sin()
    out[..., 0, 1] = -angle.sin()
    out[..., 2, 2] = 1
    return out


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
    columns = {
        "shift": [(one, zero), (zero, one)],
        "rigid": [(one, zero), (zero, one), (-y, x)],
    }.get(model, [(one, zero), (zero, one), (x, zero), (y, zero), (zero, x), (zero, y)])
    if model == "homography":
        columns = [*columns, (-x * x, -x * y), (-x * y, -y * y)]
    return torch.stack([c[0] for c in columns]), torch.stack([c[1] for c in columns])


def increment(model: str, delta: Tensor, size: float) -> Tensor:
    """The motions `(B, 3, 3)` of small parameters `(B, P)`, in the order and scale of `generators`."""
    out = identity(len(delta))
    if model == "rigid":
        out = rotation(delta[:, 2] / size)
    elif model in ("affine", "homography"):
        out[:, :2, :2] += delta[:, 2:6].reshape(-1, 2, 2) / size
    if model == "homography":
        out[:, 2, :2] = delta[:, 6:] / size**2
    out[:, :2, 2] = delta[:, :2]
    return out
