"""The skip network: an hourglass of convolutions with narrow skip connections.

(Ulyanov, Vedaldi, Lempitsky 2018, "Deep image prior".)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

Pad = Literal["reflect", "zeros"]
SLOPE = 0.2  # of the leaky rectifier


class Convolution(nn.Sequential):
    """Padded convolution, batch normalisation with the batch's statistics, leaky rectifier."""

    def __init__(
        self, inputs: int, outputs: int, size: int, *, stride: int = 1, pad: Pad = "reflect"
    ) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, size, stride, (size - 1) // 2, padding_mode=pad),
            nn.BatchNorm2d(outputs, track_running_stats=False),
            nn.LeakyReLU(SLOPE, inplace=True),
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
        self.up = up
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
            deep = F.interpolate(deep, scale_factor=2, mode=self.up)
            joined = self.join[i](torch.cat((self.skips[i](levels[i]), deep), 1))
            deep = self.rise[i](joined)
        picture: Tensor = self.last(deep)
        return picture
