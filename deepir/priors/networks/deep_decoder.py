"""The deep decoder: the scene as what a network without convolutions draws."""

from __future__ import annotations

from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.fields.base import Shape, check_counts
from deepir.priors.networks.base import Network
from deepir.registry import register


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

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        width: int = 64,
        blocks: int = 6,
        **options: Any,
    ) -> None:
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
