"""A picture doubled in size, joined with another, normalised and convolved, with half the products.

A 3 x 3 convolution is three along x, the results moved by a row up, not at all, and a row down, and added. Each of the
three commutes with the doubling of the rows: so it works on half as many, and what it gives is doubled. Normalisation
is linear in each channel, and goes into the weights.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

SUM = (0, 2, 3)  # over all but channels
#: Doubling the rows linearly, then its transpose, halved: what a row gives to itself, and to each neighbour.
OWN, NEXT = 5 / 8, 3 / 16


def risen(beside: Tensor, deep: Tensor, norm: nn.BatchNorm2d, convolution: nn.Conv2d) -> Tensor:
    """`convolution(norm([beside, doubled deep]))`, with linear doubling and a border that reflects.

    Args:
        beside: (B, C', 2 H, 2 W).
        deep: (B, C, H, W).
        norm: Of C' + C channels, by the batch's statistics.
        convolution: 3 x 3.
    """
    joined, (height, width) = beside.shape[1], deep.shape[-2:]
    kernel = convolution.weight[:, joined:]
    with torch.autocast(deep.device.type, enabled=False):
        wide = F.interpolate(deep, size=(height, 2 * width), mode="bilinear")
        mean, square = _Moments.apply(wide)
        scale = norm.weight[joined:] * (square - mean.square() + norm.eps).rsqrt()
        level = norm.bias[joined:] - scale * mean
        kernels = (kernel * scale[:, None, None]).split(1, dim=2)
        bias = kernel.sum((2, 3)) @ level + convolution.bias
        wide = F.pad(wide, (1, 1, 0, 0), mode="reflect")
        beside = F.batch_norm(beside, None, None, norm.weight[:joined], norm.bias[:joined], True, 0, norm.eps)
        beside = F.pad(beside, (1, 1, 1, 1), mode="reflect")
    result: Tensor = _Rows.apply(
        F.conv2d(beside, convolution.weight[:, :joined], bias), *(F.conv2d(wide, each) for each in kernels)
    )
    return result


class _Moments(torch.autograd.Function):
    """Means, by channel, of a picture whose rows are doubled, and of its square, without doubling them."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> tuple[Tensor, Tensor]:
        around = OWN * x
        around[:, :, 1:].add_(x[:, :, :-1], alpha=NEXT)
        around[:, :, :-1].add_(x[:, :, 1:], alpha=NEXT)
        for edge in (0, -1):
            around[:, :, edge].add_(x[:, :, edge], alpha=NEXT)
        ctx.save_for_backward(around)
        dtype = torch.promote_types(x.dtype, torch.float32)
        count = x.numel() // x.shape[1]
        return x.sum(SUM, dtype=dtype) / count, (x * around).sum(SUM, dtype=dtype) / count

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, mean: Tensor, square: Tensor) -> Tensor:
        (around,) = ctx.saved_tensors
        count = around.numel() // around.shape[1]
        level, slope = ((each / count).to(around)[:, None, None] for each in (mean, 2 * square))
        return torch.addcmul(level, slope, around)


class _Rows(torch.autograd.Function):
    """`base` and three pictures of half as many rows, which are doubled; the first and last are those of the rows
    above and below."""

    @staticmethod
    def forward(ctx: Any, base: Tensor, *halves: Tensor) -> Tensor:
        size = base.shape[-2:]
        above, here, below = (F.interpolate(each, size=size, mode="bilinear") for each in halves)
        total = base + here
        total[:, :, 1:] += above[:, :, :-1]
        total[:, :, 0] += above[:, :, 1]
        total[:, :, :-1] += below[:, :, 1:]
        total[:, :, -1] += below[:, :, -2]
        return total

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, ...]:
        above, below = torch.empty_like(gradient), torch.empty_like(gradient)
        above[:, :, :-1], above[:, :, -1] = gradient[:, :, 1:], 0
        above[:, :, 1] += gradient[:, :, 0]
        below[:, :, 1:], below[:, :, 0] = gradient[:, :, :-1], 0
        below[:, :, -2] += gradient[:, :, -1]
        *batch, height, width = gradient.shape
        half = [*batch, height // 2, width]
        folded = (
            torch.ops.aten.upsample_bilinear2d_backward(each, [height, width], half, False)
            for each in (above, gradient, below)
        )
        return gradient, *folded
