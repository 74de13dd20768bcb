"""Sampling of a cubic B-spline at moved points: compiled loops on the CPU, torch elsewhere.

Source: Unser, Aldroubi, Eden 1993, "B-spline signal processing".
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor

#: Smallest side of a canvas, px: the support of a cubic spline.
MIN_CANVAS_SIDE = 4
#: Standard deviation of a coefficient for white noise of one in the image, 12 ** 0.5: along an axis, the inverse of the
#: spline at the pixels, `(2 + cos w) / 3`, has the mean square 12 ** 0.5.
NOISE_GAIN = 12**0.5


class SplineWarp(torch.autograd.Function):
    """Warp of spline coefficients `scene` (1 or N, C, Hc, Wc) to frames (N, C, h, w), on the CPU.

    `motion`: homographies (N, 3, 3) float64, or sampling points (N, 2, h, w) as (x, y) in the type of the scene; px,
    from the centres of frame and canvas.
    """

    @staticmethod
    def forward(ctx: Any, scene: Tensor, motion: Tensor, size: tuple[int, int]) -> Tensor:
        """The frames.

        Raises:
            ValueError: As many scenes as neither one nor the frames.
        """
        from deepir.kernels.bspline import warp
        from deepir.kernels.compile import parallel_for

        if len(scene) not in (1, len(motion)):
            raise ValueError(f"warp: {len(scene)} scenes for {len(motion)} frames")
        scene, motion = scene.contiguous(), motion.contiguous()
        ctx.save_for_backward(scene, motion)
        out = scene.new_empty(len(motion), scene.shape[1], *size)
        parallel_for(warp, size[0], scene, motion, out)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        """The gradients that are asked for; that in a homography is summed in float64."""
        from deepir.kernels.bspline import grad_displacement, grad_homography
        from deepir.kernels.compile import parallel_for

        scene, motion = ctx.saved_tensors
        gradient, to_scene, to_motion = gradient.contiguous(), None, None
        if ctx.needs_input_grad[0]:
            to_scene = warp_adjoint(gradient, motion, scene.shape)
        if ctx.needs_input_grad[1] and motion.ndim == 4:
            to_motion = torch.empty_like(motion)
            parallel_for(grad_displacement, gradient.shape[-2], gradient, scene, motion, to_motion)
        elif ctx.needs_input_grad[1]:
            height = gradient.shape[-2]
            sums = motion.new_zeros(len(motion), height, 3, 2)
            parallel_for(grad_homography, height, gradient, scene, motion, sums)
            y = torch.arange(height, dtype=motion.dtype) - (height - 1) / 2
            one, by_x = sums.unbind(-1)
            to_motion = torch.stack((by_x.sum(1), y @ one, one.sum(1)), -1)
        return to_scene, to_motion, None


def warp_adjoint(frames: Tensor, motion: Tensor, shape: Sequence[int]) -> Tensor:
    """Adjoint of `SplineWarp`: frames (N, C, h, w) scattered to coefficients of this shape."""
    from deepir.kernels.bspline import warp_adjoint as scatter
    from deepir.kernels.compile import parallel_for

    scene = frames.new_zeros(shape)
    parallel_for(scatter, shape[-2], frames.contiguous(), motion.contiguous(), scene)
    return scene


def sample(scene: Tensor, points: Tensor) -> Tensor:
    """Values of the spline `scene` at `points` (N, h, w, 2), (x, y) px from the centre of the canvas.

    Four bilinear samples, at the centres of mass of the weights of four coefficients each, make one of the cubic
    spline (Sigg and Hadwiger 2005, "Fast third-order texture filtering").
    """
    sides = scene.shape[:-3:-1]
    (x, y) = (_bilinear_pairs(points[..., i], side) for i, side in enumerate(sides))
    scene = scene.expand(len(points), -1, -1, -1)
    total = torch.zeros((), dtype=scene.dtype, device=scene.device)
    for at_y, weight_y in y:
        for at_x, weight_x in x:
            grid = torch.stack([(2 * at + 1) / side - 1 for at, side in zip((at_x, at_y), sides, strict=True)], -1)
            found = F.grid_sample(scene, grid, mode="bilinear", padding_mode="border", align_corners=False)
            total = total + (weight_x * weight_y)[:, None] * found
    return total


def _bilinear_pairs(at: Tensor, side: int) -> list[tuple[Tensor, Tensor]]:
    """Along one axis, from the centre: where the first and the last two coefficients meet, and their weights."""
    at = (at + (side - 1) / 2).clamp(1, side - 2)
    second = at.detach().floor().clamp(max=side - 3)
    f = at - second
    first, third, last = (1 - f) ** 3 / 6, 2 / 3 - (1 - f) ** 2 * (1 + f) / 2, f**3 / 6
    low = first + 2 / 3 - f * f * (2 - f) / 2
    high = third + last
    return [(second - first / low, low), (second + 1 + last / high, high)]


def to_pixels(scene: Tensor) -> Tensor:
    """Values of the spline `scene` (S, C, Hc, Wc) at pixel centres, same shape."""
    along = torch.tensor([1.0, 4.0, 1.0], dtype=scene.dtype, device=scene.device) / 6
    padded = F.pad(scene, (1, 1, 1, 1), mode="replicate")
    channels = scene.shape[1]
    kernel = (along[:, None] * along).expand(channels, 1, 3, 3)
    return F.conv2d(padded, kernel, groups=channels)
