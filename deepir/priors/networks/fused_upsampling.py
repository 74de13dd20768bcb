"""Fused upsample-concatenate-normalise-convolve block, with a quarter of the products.

Linear upsampling inserts zeros and smooths. The convolution commutes with the smoothing and then acts on an image with
three quarters of zeros: a transposed convolution of stride two. Batch normalisation is linear in each channel and is
folded into the weights. Only the border, where padding does not commute, needs corrections.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor, nn

#: Weights along an axis of the filter after a convolution with zeros between the pixels.
INTERPOLATION_WEIGHTS = (0.25, 0.75, 0.75, 0.25)
#: Weights along an axis of linear upsampling by two followed by its adjoint, divided by two.
UPSAMPLING_GRAM_WEIGHTS = (3 / 16, 5 / 8, 3 / 16)


def upsample_join_convolve(
    skip: Tensor, deep: Tensor, norm: nn.BatchNorm2d, convolution: nn.Conv2d
) -> Tensor:
    """`convolution(norm([skip, upsampled deep]))`, with bilinear upsampling and reflected borders.

    Args:
        skip: (B, C', 2 H, 2 W).
        deep: (B, C, H, W).
        norm: Of C' + C channels, by the batch's statistics.
        convolution: 3 x 3, with a bias.
    """
    joined = skip.shape[1]
    weights, kernel = convolution.weight.split((joined, deep.shape[1]), dim=1)
    with torch.autocast(deep.device.type, enabled=False):
        mean, variance = _moments(deep)
        scale = norm.weight[joined:] * (variance + norm.eps).rsqrt()
        bias = convolution.bias + kernel.sum((2, 3)) @ (norm.bias[joined:] - scale * mean)
        kernel = (kernel * scale[:, None, None]).to(deep)
        skip = F.batch_norm(skip, None, None, norm.weight[:joined], norm.bias[:joined], True, 0, norm.eps)
        skip = F.pad(skip, [1] * 4, mode="reflect")
        around = F.pad(deep, [1] * 4, mode="replicate")
        spread = F.conv_transpose2d(around, kernel.flip(2, 3).transpose(0, 1), stride=2, padding=1)
        smooth, border = _separable_filter(spread, INTERPOLATION_WEIGHTS), _border_corrections(deep, kernel)
    result: Tensor = _AddBorder.apply(F.conv2d(skip, weights, bias) + smooth, *border)
    return result


def _moments(deep: Tensor) -> tuple[Tensor, Tensor]:
    """Mean and variance of each channel of the doubled picture."""
    dtype = torch.promote_types(deep.dtype, torch.float32)
    count = deep.numel() // deep.shape[1]
    mean = deep.sum((0, 2, 3), dtype=dtype) / count
    # Of what is not centred, the variance could be below zero in bfloat16.
    centred = deep - mean.detach().to(deep)[:, None, None]
    twice = _separable_filter(F.pad(centred, [1] * 4, mode="replicate"), UPSAMPLING_GRAM_WEIGHTS)
    return mean, (centred * twice).sum((0, 2, 3), dtype=dtype) / count


def _separable_filter(x: Tensor, weights: tuple[float, ...]) -> Tensor:
    """Each channel convolved with the weights along both axes."""
    line = torch.tensor(weights, dtype=x.dtype, device=x.device)
    return F.conv2d(x, torch.outer(line, line).expand(x.shape[1], 1, -1, -1), groups=x.shape[1])


def _border_corrections(deep: Tensor, kernel: Tensor) -> list[Tensor]:
    """What is missing of the first and last row and column, where the outermost pixels were repeated."""
    strips = deep[:, :, :2], deep[:, :, -2:].flip(2), deep[..., :2].mT, deep[..., -2:].flip(3).mT
    kernels = kernel[:, :, :1], kernel[:, :, 2:], kernel[..., :1].mT, kernel[..., 2:].mT
    border = []
    for i, (strip, weights) in enumerate(zip(strips, kernels, strict=True)):
        first, second = F.interpolate(strip, scale_factor=2, mode="bilinear")[:, :, :2].split(1, dim=2)
        if i < 2:  # with the corners
            beyond = F.pad(second, (1, 1, 0, 0), "reflect") - F.pad(first, (1, 1, 0, 0), "replicate")
        else:
            beyond = F.pad(second - first, (1, 1, 0, 0))
        border.append((weights.flatten(1) @ F.unfold(beyond, (1, 3)))[:, :, None])
    return [*border[:2], *(each.mT for each in border[2:])]


class _AddBorder(torch.autograd.Function):
    """A picture, and what is added to its first and last row, first and last column."""

    @staticmethod
    def forward(ctx: Any, picture: Tensor, *border: Tensor) -> Tensor:
        ctx.mark_dirty(picture)
        for part, more in zip(_borders(picture), border, strict=True):
            part.add_(more)
        return picture

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, ...]:
        return gradient, *_borders(gradient)


def _borders(picture: Tensor) -> tuple[Tensor, ...]:
    return picture[:, :, :1], picture[:, :, -1:], picture[..., :1], picture[..., -1:]
