"""A network as a field, over coordinates."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from deepir.fields.base import Shape, StandardisedField


class Network(StandardisedField):
    """A scene `center + scale * draw()`, with the output of a network and mean and deviation of the initial scene.

    Args:
        shape: Of the scene, (S, 1, H, W).
        neutral: Level before initialisation.
        residual: Whether the output of the network is added to the initial scene.
        bf16: Whether the layers are computed in bfloat16.
    """

    start: Tensor
    can_represent = False

    def __init__(self, shape: Shape, neutral: float = 0.0, *, residual: bool = False, bf16: bool = False) -> None:
        super().__init__(shape, neutral)
        self.residual, self.bf16 = residual, bf16
        #: Initial scene, in units of the network.
        self.register_buffer("start", torch.zeros(self.shape))

    def draw(self) -> Tensor:
        """Output of the network, of `shape` or broadcast to it."""
        raise NotImplementedError

    def forward(self) -> Tensor:
        """`center + scale * draw()`, with `residual` plus the initial scene."""
        wanted = self.bf16 and self.center.dtype == torch.float32
        # Normalisation, sums and parameters stay float32.
        with torch.autocast(self.center.device.type, torch.bfloat16, enabled=wanted):
            picture = self.draw()
        picture = picture.to(self.center.dtype)
        picture = picture + self.start if self.residual else picture
        return self.center + self.scale * picture.expand(self.shape)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Store mean, deviation and image as the initial scene; the network is unchanged."""
        self.start.copy_(self.standardise(value))

    def begin_at_start(self, last: nn.Linear | nn.Conv2d) -> None:
        """With `residual`, set the last layer to zero: the first output is the initial scene."""
        if self.residual:
            nn.init.zeros_(last.weight)
            if last.bias is not None:
                nn.init.zeros_(last.bias)
