"""The skip network: an hourglass of convolutions with narrow skip connections.

(Ulyanov, Vedaldi, Lempitsky 2018, "Deep image prior".)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.kernels.dispatch import is_compiled
from deepir.priors.networks.fused_upsampling import upsample_join_convolve

Pad = Literal["reflect", "zeros"]
#: Negative slope of the leaky rectifier.
NEGATIVE_SLOPE = 0.2
#: Channels from which the fused block is faster on a CPU.
MIN_FUSED_CHANNELS = 128
#: Pixels of the coarse image from which the fused block is faster on a CPU.
MIN_FUSED_PIXELS = 1024


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

    def __init__(
        self, inputs: int, outputs: int, size: int, *, stride: int = 1, pad: Pad = "reflect"
    ) -> None:
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
        if self._fused_is_faster(deep):
            x = upsample_join_convolve(skip, deep, self.join[i], convolution)  # type: ignore[arg-type]
        else:
            x = convolution(self.join[i](torch.cat((skip, self._upsample(deep)), 1)))
        for layer in (*after, mixed):
            x = layer(x)
        return x

    def _fused_is_faster(self, deep: Tensor) -> bool:
        published = self.up == "bilinear" and self.pad == "reflect"
        large = deep.shape[1] >= MIN_FUSED_CHANNELS and deep[0, 0].numel() >= MIN_FUSED_PIXELS
        return published and large and is_compiled(deep)

    def _upsample(self, x: Tensor) -> Tensor:
        """`x` with twice the height and width, in its own precision."""
        with torch.autocast(x.device.type, enabled=False):
            doubled = F.interpolate(x, scale_factor=2, mode=self.up)
        # Its gradient is a slice of that of what it is joined with, and takes nine times as long if it is not packed.
        if doubled.requires_grad:
            doubled.register_hook(_to_channels_last)
        return doubled


def _to_channels_last(gradient: Tensor) -> Tensor:
    return gradient.contiguous(memory_format=torch.channels_last)
