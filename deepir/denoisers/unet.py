"""A small bias-free U-net for denoising, and the denoiser `cnn`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir import weights
from deepir.registry import register

FOLD = 2  # side of the pixel blocks that become channels, px
PADDING = 16  # padding beyond the border, px: its influence does not reach further
MAX_CHANGE_SIGMAS = 4.0  # largest change of a pixel, noise standard deviations: noise does not reach further


class Residual(nn.Module):
    """Two convolutions whose result is added to the input."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.first, self.second = (nn.Conv2d(width, width, 3, padding=1, bias=False) for _ in range(2))

    def forward(self, x: Tensor) -> Tensor:
        """Same shape as `x`."""
        out: Tensor = x + self.second(F.relu(self.first(x)))
        return out


class UNet(nn.Module):
    """Noise-conditional U-net without units, `(image (B, 1, H, W), sigma) -> image`.

    There is no bias, so with `a > 0` the result scales with picture and noise (Mohan et al. 2020, "Robust and
    interpretable blind image denoising via bias-free convolutional neural networks"); the first filters have mean zero
    over the picture, so a level that is added to it is added to the result:
    `D(a x + b, a sigma) = a D(x, sigma) + b`. The strength is a channel of its own and pixels are folded (Zhang et
    al. 2018, "FFDNet"); the shape is that of DRUNet in miniature (Zhang et al. 2021, "Plug-and-play image restoration
    with deep denoiser prior").

    Args:
        widths: Channels of each scale, the finest first. H and W must be multiples of `multiple`.
    """

    def __init__(self, widths: Sequence[int] = (32, 64, 128)) -> None:
        super().__init__()
        self.multiple = FOLD * 2 ** (len(widths) - 1)
        steps = list(pairwise(widths))
        self.head = nn.Conv2d(FOLD**2 + 1, widths[0], 3, bias=False)
        self.before = nn.ModuleList(Residual(fine) for fine, _ in steps)
        self.down = nn.ModuleList(nn.Conv2d(fine, coarse, 2, 2, bias=False) for fine, coarse in steps)
        self.middle = Residual(widths[-1])
        self.up = nn.ModuleList(nn.ConvTranspose2d(coarse, fine, 2, 2, bias=False) for fine, coarse in steps)
        self.after = nn.ModuleList(Residual(fine) for fine, _ in steps)
        self.tail = nn.Conv2d(widths[0], FOLD**2, 3, padding=1, bias=False)

    def forward(self, picture: Tensor, sigma: Tensor | float) -> Tensor:
        """The picture without its noise; `sigma` is a number, or (B, 1, 1, 1)."""
        folded = F.pixel_unshuffle(picture, FOLD)
        strength = torch.ones_like(folded[:, :1]) * sigma
        # Zeros around it would be a level.
        shown = F.pad(torch.cat((folded, strength), 1), (1, 1, 1, 1), mode="replicate")
        of_picture, of_strength = self.head.weight.split((FOLD**2, 1), dim=1)
        # The filters of the picture are made independent of its level.
        x = F.conv2d(shown, torch.cat((of_picture - of_picture.mean((1, 2, 3), keepdim=True), of_strength), 1))
        levels = [x]
        for before, down in zip(self.before, self.down, strict=True):
            levels.append(before(x))
            x = down(levels[-1])
        x = self.middle(x)
        for up, after in zip(reversed(self.up), reversed(self.after), strict=True):
            x = after(up(x) + levels.pop())
        return picture - F.pixel_shuffle(self.tail(x + levels.pop()), FOLD)

    def of_any_size(self, picture: Tensor, sigma: Tensor | float) -> Tensor:
        """`forward` for any H and W, by replicate padding."""
        height, width = picture.shape[-2:]
        bottom, right = (PADDING + -side % self.multiple for side in (height, width))
        padded = F.pad(picture, (PADDING, right, PADDING, bottom), mode="replicate")
        out: Tensor = self(padded, sigma)
        return out[..., PADDING : PADDING + height, PADDING : PADDING + width]


@register("denoiser", "cnn")
def cnn(picture: Tensor, noise: float) -> Tensor:
    """A small U-net, trained by `deepir train denoiser`."""
    return apply_network(weights.shipped(UNet, "denoiser").to(picture).of_any_size, picture, noise)


@torch.no_grad()
def apply_network(network: Callable[[Tensor, float], Tensor], picture: Tensor, noise: float) -> Tensor:
    """A picture (..., H, W) after a network for pictures (B, 1, H, W), with changes up to `MAX_CHANGE_SIGMAS`."""
    flat, most = picture.reshape(-1, 1, *picture.shape[-2:]), MAX_CHANGE_SIGMAS * noise
    return (flat + (network(flat, noise) - flat).clamp(-most, most)).reshape(picture.shape)
