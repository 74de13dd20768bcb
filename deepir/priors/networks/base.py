"""What all scenes that a network draws have in common."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from deepir.fields.base import Field, Shape


class Network(Field):
    """A picture that a network draws, in units of the spread of what it starts from: `center + scale * draw()`.

    Args:
        shape: Of the scene, (S, 1, H, W).
        neutral: The level, until it starts somewhere.
        residual: Whether the network draws what is added to what the scene starts at.
        bf16: Whether its layers are computed in bfloat16.
    """

    center: Tensor
    scale: Tensor
    start: Tensor
    can_represent = False

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, residual: bool = False, bf16: bool = False
    ) -> None:
        super().__init__(shape, neutral)
        self.residual, self.bf16 = residual, bf16
        self.register_buffer("center", torch.tensor(float(neutral)))
        self.register_buffer("scale", torch.tensor(1.0))
        #: What the field starts from, in the network's units.
        self.register_buffer("start", torch.zeros(self.shape))

    def draw(self) -> Tensor:
        """The network's picture, of `shape` or one that is expanded to it."""
        raise NotImplementedError

    def forward(self) -> Tensor:
        """`center + scale * draw()`, and what the field starts from with `residual`."""
        with self._computing():
            picture = self.draw()
        picture = picture.to(self.center.dtype)
        picture = picture + self.start if self.residual else picture
        return self.center + self.scale * picture.expand(self.shape)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over level, spread and, where it is made use of, the picture; the network stays as it is."""
        value = value.to(self.start).expand(self.shape)
        deviation = value.std() if value.numel() > 1 else value.new_zeros(())
        self.center.copy_(value.mean())
        self.scale.copy_(torch.where(deviation > 0, deviation, torch.ones_like(deviation)))
        self.start.copy_((value - self.center) / self.scale)

    def begin_at_start(self, last: nn.Linear | nn.Conv2d) -> None:
        """Set the last layer of a `residual` to zero: the picture begins at what it starts from."""
        if self.residual:
            nn.init.zeros_(last.weight)
            if last.bias is not None:
                nn.init.zeros_(last.bias)

    @contextmanager
    def _computing(self) -> Iterator[None]:
        """In bfloat16 where that is wanted; normalisation, sums and parameters stay float32."""
        wanted = self.bf16 and self.center.dtype == torch.float32
        with torch.autocast(self.center.device.type, torch.bfloat16, enabled=wanted):
            yield
