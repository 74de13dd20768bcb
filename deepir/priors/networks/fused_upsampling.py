"""A picture doubled in size, joined with another, normalised and convolved, for a quarter of the products.

To double is to put zeros between the pixels and to smooth. A convolution may come between the two, and then three
quarters of what it reads are zeros: it is a transposed one of stride two. Normalisation is linear in each channel, and
goes into the weights. Only next to the border, where a reflected picture is not a smooth one, is there more to do.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

#: What smooths, along an axis, a picture that was convolved with zeros between its pixels.
SMOOTH = (0.25, 0.75, 0.75, 0.25)
#: Doubling along an axis and then its transpose, halved: what a pixel gives to itself, and to each neighbour.
TWICE = (3 / 16, 5 / 8, 3 / 16)


def upsample_join_convolve(
    beside: Tensor, deep: Tensor, norm: nn.BatchNorm2d, convolution: nn.Conv2d
) -> Tensor:
    """`convolution(norm([beside, doubled deep]))`, with linear doubling and a border that reflects.

    Args:
        beside: (B, C', 2 H, 2 W).
        deep: (B, C, H, W).
        norm: Of C' + C channels, by the batch's statistics.
        convolution: 3 x 3, with a bias.
    """
    joined = beside.shape[1]
    weights, kernel = convolution.weight.split((joined, deep.shape[1]), dim=1)
    with torch.autocast(deep.device.type, enabled=False):
        mean, variance = _moments(deep)
        scale = norm.weight[joined:] * (variance + norm.eps).rsqrt()
        bias = convolution.bias + kernel.sum((2, 3)) @ (norm.bias[joined:] - scale * mean)
        kernel = (kernel * scale[:, None, None]).to(deep)
        beside = F.batch_norm(beside, None, None, norm.weight[:joined], norm.bias[:joined], True, 0, norm.eps)
        beside = F.pad(beside, [1] * 4, mode="reflect")
        around = F.pad(deep, [1] * 4, mode="replicate")
        spread = F.conv_transpose2d(around, kernel.flip(2, 3).transpose(0, 1), stride=2, padding=1)
        smooth, rim = _filtered(spread, SMOOTH), _rim(deep, kernel)
    result: Tensor = _Rimmed.apply(F.conv2d(beside, weights, bias) + smooth, *rim)
    return result


def _moments(deep: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance of each channel of the doubled picture."""
    dtype = torch.promote_types(deep.dtype, torch.float32)
    count = deep.numel() // deep.shape[1]
    mean = deep.sum((0, 2, 3), dtype=dtype) / count
    # Of what is not centred, the variance could be below zero in bfloat16.
    centred = deep - mean.detach().to(deep)[:, None, None]
    twice = _filtered(F.pad(centred, [1] * 4, mode="replicate"), TWICE)
    return mean, (centred * twice).sum((0, 2, 3), dtype=dtype) / count


def _filtered(x: Tensor, weights: tuple[float, ...]) -> Tensor:
    """Each channel convolved with the weights along both axes."""
    line = torch.tensor(weights, dtype=x.dtype, device=x.device)
    return F.conv2d(x, torch.outer(line, line).expand(x.shape[1], 1, -1, -1), groups=x.shape[1])


def _rim(deep: Tensor, kernel: Tensor) -> list[Tensor]:
    """What is missing of the first and last row and column, where the outermost pixels were repeated."""
    strips = deep[:, :, :2], deep[:, :, -2:].flip(2), deep[..., :2].mT, deep[..., -2:].flip(3).mT
    kernels = kernel[:, :, :1], kernel[:, :, 2:], kernel[..., :1].mT, kernel[..., 2:].mT
    rim = []
    for i, (strip, weights) in enumerate(zip(strips, kernels, strict=True)):
        first, second = F.interpolate(strip, scale_factor=2, mode="bilinear")[:, :, :2].split(1, dim=2)
        if i < 2:  # with the corners
            beyond = F.pad(second, (1, 1, 0, 0), "reflect") - F.pad(first, (1, 1, 0, 0), "replicate")
        else:
            beyond = F.pad(second - first, (1, 1, 0, 0))
        rim.append((weights.flatten(1) @ F.unfold(beyond, (1, 3)))[:, :, None])
    return [*rim[:2], *(each.mT for each in rim[2:])]


class _Rimmed(torch.autograd.Function):
    """A picture, and what is added to its first and last row, first and last column."""

    @staticmethod
    def forward(ctx: Any, picture: Tensor, *rim: Tensor) -> Tensor:
        ctx.mark_dirty(picture)
        for part, more in zip(_outermost(picture), rim, strict=True):
            part.add_(more)
        return picture

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, ...]:
        return gradient, *_outermost(gradient)


def _outermost(picture: Tensor) -> tuple[Tensor, ...]:
    return picture[:, :, :1], picture[:, :, -1:], picture[..., :1], picture[..., -1:]
