"""The network with skip connections, and its fused upsampling."""

from __future__ import annotations

from collections.abc import Sequence
from operator import methodcaller
from typing import Any, Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.kernels.threads import is_compiled

#: Weights along an axis of the filter after a convolution with zeros between the pixels.
INTERPOLATION_WEIGHTS = (0.25, 0.75, 0.75, 0.25)
#: Weights along an axis of linear upsampling by two followed by its adjoint, divided by two.
UPSAMPLING_GRAM_WEIGHTS = (3 / 16, 5 / 8, 3 / 16)
NEGATIVE_SLOPE = 0.2  # negative slope of the leaky rectifier
MIN_FUSED_CHANNELS = 128  # channels from which the fused block is faster on a CPU
MIN_FUSED_PIXELS = 1024  # pixels of the coarse image from which the fused block is faster on a CPU


def upsample_join_convolve(skip: Tensor, deep: Tensor, norm: nn.BatchNorm2d, convolution: nn.Conv2d) -> Tensor:
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


Pad = Literal["reflect", "zeros"]


class Padded(nn.Conv2d):
    """A convolution that does not change the size; what is reflected beyond the edges stays in the input's precision.

    Autocast would make float32 of it.
    """

    def __init__(self, inputs: int, outputs: int, size: int, stride: int, pad: Pad) -> None:
        self.beyond = (size - 1) // 2
        mode = pad if self.beyond else "zeros"
        super().__init__(inputs, outputs, size, stride, self.beyond, padding_mode=mode)

    def forward(self, x: Tensor) -> Tensor:
        """(B, inputs, H, W) -> (B, outputs, H / stride, W / stride)."""
        if self.padding_mode == "zeros":
            return super().forward(x)
        with torch.autocast(x.device.type, enabled=False):
            x = F.pad(x, [self.beyond] * 4, mode=self.padding_mode)
        return F.conv2d(x, self.weight, self.bias, self.stride)


class Convolution(nn.Sequential):
    """Padded convolution, batch normalisation with the batch's statistics, leaky rectifier."""

    def __init__(self, inputs: int, outputs: int, size: int, *, stride: int = 1, pad: Pad = "reflect") -> None:
        super().__init__(
            Padded(inputs, outputs, size, stride, pad),
            nn.BatchNorm2d(outputs, track_running_stats=False),
            nn.LeakyReLU(NEGATIVE_SLOPE, inplace=True),
        )


class Skip(nn.Module):
    """(B, inputs, H, W) -> (B, 1, H, W); H and W are multiples of `2 ** len(widths)`.

    Args:
        inputs: Channels of the input.
        widths: Channels of each scale, the finest first.
        skip: Channels of each skip connection.
        up: `bilinear` or `nearest`.
        pad: `reflect` or `zeros`.
    """

    def __init__(
        self, inputs: int, widths: Sequence[int], *, skip: int = 4, up: str = "bilinear", pad: Pad = "reflect"
    ) -> None:
        super().__init__()
        self.up, self.pad = up, pad
        below = [*widths[1:], widths[-1]]
        before = [inputs, *widths[:-1]]
        self.down = nn.ModuleList(
            nn.Sequential(Convolution(a, w, 3, stride=2, pad=pad), Convolution(w, w, 3, pad=pad))
            for a, w in zip(before, widths, strict=True)
        )
        self.skips = nn.ModuleList(Convolution(a, skip, 1) for a in before)
        self.join = nn.ModuleList(nn.BatchNorm2d(b + skip, track_running_stats=False) for b in below)
        self.rise = nn.ModuleList(
            nn.Sequential(Convolution(b + skip, w, 3, pad=pad), Convolution(w, w, 1))
            for b, w in zip(below, widths, strict=True)
        )
        self.last = nn.Conv2d(widths[0], 1, 1)

    def forward(self, x: Tensor) -> Tensor:
        """The picture, not yet through a sigmoid."""
        levels = [x]
        for down in self.down:
            levels.append(down(levels[-1]))
        deep = levels.pop()
        for i in reversed(range(len(levels))):
            deep = self._join(i, self.skips[i](levels[i]), deep)
        picture: Tensor = self.last(deep)
        return picture

    def _join(self, i: int, skip: Tensor, deep: Tensor) -> Tensor:
        """What the scale `i` makes of the one below, doubled, with its own skip connection skip it."""
        first, mixed = self.rise[i].children()
        convolution, *after = first.children()
        published = self.up == "bilinear" and self.pad == "reflect"
        large = deep.shape[1] >= MIN_FUSED_CHANNELS and deep[0, 0].numel() >= MIN_FUSED_PIXELS
        if published and large and is_compiled(deep):
            x = upsample_join_convolve(skip, deep, self.join[i], convolution)  # type: ignore[arg-type]
        else:
            x = convolution(self.join[i](torch.cat((skip, self._upsample(deep)), 1)))
        for layer in (*after, mixed):
            x = layer(x)
        return x

    def _upsample(self, x: Tensor) -> Tensor:
        """`x` with twice the height and width, in its own precision."""
        with torch.autocast(x.device.type, enabled=False):
            doubled = F.interpolate(x, scale_factor=2, mode=self.up)
        # Its gradient is a slice of that of what it is joined with, and takes nine times as long if it is not packed.
        if doubled.requires_grad:
            doubled.register_hook(methodcaller("contiguous", memory_format=torch.channels_last))
        return doubled
