"""Dense motion: parallax, and scenes that are not rigid."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.arrays.differences import squared_gradient
from deepir.fields.base import Field, Shape
from deepir.fields.motion import PARAMETER_SCALE
from deepir.operators.warp import project_pixels
from deepir.registry import register

#: Nats that a step of one px costs for each px of its length. Where the scene has no texture nothing else holds it.
WEIGHT = 1.0
FARTHEST = 1000.0  # px
ROUNDING = 0.05  # px between control points below which a difference costs its square


@register("field", "flow")
class Flow(Field):
    """Dense motion, `frame_k(p) = scene(T_k p + u_k(p))`: homographies, and displacements on a grid of cubic B-splines.

    The value is where each pixel looks, (N, h, w, 2), from the frame's centre; frame 0 does not move, ever. Its own
    penalty is the total variation of the displacements, so that they may jump where a near thing ends. (Grids that
    are refined: Rueckert et al. 1999, "Nonrigid registration using free-form deformations".)

    Args:
        shape: (N, ...); the rest follows from `size`.
        size: (h, w) of a frame.
        ratio: Px of the scene for each of the detector's.
        spacing: Of the control points, in detector px.
        weight: Nats that a step of one px costs for each px of its length.
    """

    model: ClassVar[str | None] = "homography"
    weight: Tensor
    start: Tensor
    down: Tensor
    across: Tensor

    def __init__(
        self,
        shape: Shape,
        neutral: float = 0.0,
        *,
        size: tuple[int, int],
        ratio: float = 1.0,
        spacing: float = 16.0,
        weight: float = WEIGHT,
    ) -> None:
        super().__init__((shape[0], *size, 2), neutral)
        if not 2 <= spacing <= FARTHEST:
            raise ValueError(f"spacing must be 2 to {FARTHEST:g} px, not {spacing}")
        if not 0 <= weight < math.inf:
            raise ValueError(f"weight must be a number of at least 0, not {weight}")
        self.size, self.ratio, self.spacing = (size[0], size[1]), ratio, spacing
        self.preconditioning_scale = PARAMETER_SCALE / spacing
        # How many samples feel a step of one parameter: the spline's square, summed.
        self.n_samples_affected = (0.479 * spacing * ratio) ** 2
        self.register_buffer("weight", torch.tensor(float(weight)))
        still = project_pixels(torch.eye(3)[None], self.size).expand(self.shape)
        self.register_buffer("start", still, persistent=False)
        for name, side in zip(("down", "across"), size, strict=True):
            self.register_buffer(name, _splines(side, spacing * ratio), persistent=False)
        self.values = nn.Parameter(torch.zeros(shape[0] - 1, 2, self.down.shape[1], self.across.shape[1]))

    def forward(self) -> Tensor:
        """Where the homographies look, and the displacements."""
        moved = self.down @ (self.ratio * self.preconditioning_scale * self.values) @ self.across.mT
        first, others = self.start.permute(0, 3, 1, 2).tensor_split([1])
        return torch.cat((first, others + moved)).permute(0, 2, 3, 1)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Take over homographies (N, 3, 3), without displacements, or points (N, h, w, 2), as displacements."""
        if value.shape[1:] == (3, 3):
            self.start = project_pixels(value.to(self.start.device).double(), self.size).to(self.start)
            self.values.zero_()
            return
        own = (value.to(self.start) - self.start).permute(0, 3, 1, 2)[1:].double()
        down, across = (torch.linalg.pinv(each.double()) for each in (self.down, self.across))
        self.values.copy_(down @ own @ across.mT / (self.ratio * self.preconditioning_scale))

    def penalty(self) -> Tensor | None:
        """`weight Σ s |d|`, of the differences d of neighbouring control points, s px apart; rounded near zero."""
        squared = squared_gradient(self.preconditioning_scale * self.values).sum(1)
        rounded = squared / (torch.sqrt(squared + ROUNDING**2) + ROUNDING)
        return self.weight * self.spacing * rounded.sum()

    @classmethod
    def example(cls) -> Flow:
        """Three frames of 12 x 15 px."""
        return cls((3, 3, 3), size=(12, 15), spacing=5)


def _splines(side: int, spacing: float) -> Tensor:
    """Cubic B-splines `spacing` px apart, the second about the first pixel, at each pixel: (side, count)."""
    count = math.ceil((side - 1) / spacing) + 3
    at = torch.arange(side, dtype=torch.float64)[:, None] / spacing - (torch.arange(count) - 1)
    t = (2 - at.abs()).clamp(min=0)
    return (t**3 / 6 - 4 / 6 * (t - 1).clamp(min=0) ** 3).float()
