"""Untrained networks that draw the scene from noise: the deep image prior, and the deep decoder."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Network
from deepir.priors.networks.skip_network import Skip
from deepir.registry import register


@register("field", "dip")
class DIP(Network):
    """A skip network draws the scene from fixed noise, or from what the scene starts at.

    (Ulyanov, Vedaldi, Lempitsky 2018, "Deep image prior".) Any size: the network's canvas is larger, and cropped.
    Scenes have noise of their own, and share the network.

    Args:
        shape, neutral, bf16: See `Network`.
        width: Channels of each scale.
        scales: How often the size is halved.
        skip: Channels of the skip connections.
        inputs: Channels of noise, uniform in [0, `spread`].
        spread: Of the noise.
        picture: Whether what the scene starts at is a channel of the input too, and the network draws what is added.
        perturb: Standard deviation of what is added to the input in each iteration, anew.
        sigmoid: Whether the network's values are limited to what a sigmoid can give: four deviations about the mean.
        up: How sizes are doubled.
        pad: What lies beyond the edges.
    """

    example_shape = (1, 1, 11, 9)
    example_options: ClassVar = {"width": 4, "scales": 2, "inputs": 2}
    noise: Tensor
    drawn: Tensor

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        width: int = 32,
        scales: int = 5,
        skip: int = 4,
        inputs: int = 8,
        spread: float = 0.1,
        picture: bool = False,
        perturb: float = 0.0,
        sigmoid: bool = False,
        up: Literal["bilinear", "nearest"] = "bilinear",
        pad: Literal["reflect", "zeros"] = "reflect",
        bf16: bool = False,
    ) -> None:
        super().__init__(shape, neutral, residual=picture, bf16=bf16)
        check_counts(width=(width, 512), scales=(scales, 8), skip=(skip, 128), inputs=(inputs, 128))
        self.perturb, self.sigmoid = perturb, sigmoid
        unit = 2**scales
        # Reflection wants two px at the coarsest scale.
        self.canvas = [max(-(-side // unit), 2) * unit for side in shape[-2:]]
        self.register_buffer("noise", spread * torch.rand(shape[0], inputs, *self.canvas))
        self.register_buffer("drawn", torch.tensor(0))
        self.net = Skip(inputs + picture, [width] * scales, skip=skip, up=up, pad=pad)
        self.begin_at_start(self.net.last)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def draw(self) -> Tensor:
        """What the network makes of its input."""
        x = self.noise
        if self.residual:
            beyond = [a - b for a, b in zip(self.canvas, self.shape[-2:], strict=True)]
            start = F.pad(self.start[:, :1], (0, beyond[1], 0, beyond[0]), mode="replicate")
            x = torch.cat((x, start), 1)
        if self.perturb and torch.is_grad_enabled():
            # By how often it was drawn alone, so that a resumed solve takes the same steps.
            generator = torch.Generator().manual_seed(int(self.drawn))
            self.drawn += 1
            x = x + self.perturb * torch.randn(x.shape, generator=generator).to(x)
        picture: Tensor = self.net(x.contiguous(memory_format=torch.channels_last))
        picture = picture[..., : self.shape[-2], : self.shape[-1]]
        return 8 * picture.float().sigmoid() - 4 if self.sigmoid else picture


@register("field", "deep_decoder")
class DeepDecoder(Network):
    """Mixed channels, doubled in size again and again, from small fixed noise.

    Each block is a 1 x 1 convolution, a bilinear doubling, a rectifier and a normalisation of each channel (Heckel and
    Hand 2019, "Deep decoder"). So few parameters that it need not be stopped, but for its details. Scenes have noise
    of their own, and share the network.

    Args:
        shape, neutral: See `Network`.
        width: Channels.
        blocks: How many, the last of which does not double the size.
        options: Those of every `Network`.
    """

    example_shape = (1, 1, 11, 9)
    example_options: ClassVar = {"width": 4, "blocks": 3}

    def __init__(self, shape: Shape, neutral: float = 0.0, *, width: int = 64, blocks: int = 6, **options: Any) -> None:
        super().__init__(shape, neutral, **options)
        check_counts(width=(width, 1024), blocks=(blocks, 10))
        if blocks < 2:
            raise ValueError("blocks must be at least 2")
        unit = 2 ** (blocks - 1)
        small = [-(-side // unit) for side in shape[-2:]]
        self.register_buffer("noise", 0.1 * torch.rand(shape[0], width, *small))
        self.mix = nn.ModuleList(nn.Conv2d(width, width, 1, bias=False) for _ in range(blocks))
        self.norm = nn.ModuleList(nn.BatchNorm2d(width, track_running_stats=False) for _ in range(blocks))
        self.last = nn.Conv2d(width, 1, 1, bias=False)
        self.begin_at_start(self.last)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def draw(self) -> Tensor:
        """What the network makes of its noise."""
        x = self.noise
        for i, (mix, norm) in enumerate(zip(self.mix, self.norm, strict=True)):
            x = mix(x)
            if i + 1 < len(self.mix):
                x = F.interpolate(x, scale_factor=2, mode="bilinear")
            x = norm(F.relu(x))
        picture: Tensor = self.last(x)
        return picture[..., : self.shape[-2], : self.shape[-1]]
