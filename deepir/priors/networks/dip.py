"""The deep image prior: the scene as what an untrained skip network draws."""

from __future__ import annotations

from typing import ClassVar, Literal

import torch
import torch.nn.functional as F
from torch import Tensor

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
            x = x + self.perturb * self._fresh(x)
        picture: Tensor = self.net(x.contiguous(memory_format=torch.channels_last))
        picture = picture[..., : self.shape[-2], : self.shape[-1]]
        return 8 * picture.float().sigmoid() - 4 if self.sigmoid else picture

    def _fresh(self, like: Tensor) -> Tensor:
        """Noise that depends on how often it was drawn alone, so that a resumed solve takes the same steps."""
        generator = torch.Generator().manual_seed(int(self.drawn))
        self.drawn += 1
        return torch.randn(like.shape, generator=generator).to(like)
