"""Dense motion: parallax, and scenes that are not rigid."""

from __future__ import annotations

import math
from typing import ClassVar

import torch
from torch import Tensor, nn

from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Field, Shape
from deepir.fields.motion import PARAMETER_SCALE
from deepir.operators.warp import project_pixels
from deepir.registry import register

#: Default weight of the total variation of displacements, nats per px of a step and px of its length; without texture
#: nothing else determines them.
DEFAULT_TV_WEIGHT = 1.0
#: Largest spacing of control points, px.
MAX_SPACING = 1000.0
#: Smoothing length of the total variation, px between control points.
TV_SMOOTHING = 0.05
#: Sum of the squares of a cubic B-spline over one axis, in spacings of its control points.
SPLINE_EXTENT = 0.479


@register("field", "flow")
class Flow(Field):
    """Dense motion, `frame_k(p) = scene(T_k p + u_k(p))`: homographies plus displacements on a cubic B-spline grid.

    The value is the sampling point of each pixel, (N, h, w, 2), px from the frame's centre; frame 0 is fixed. Its
    penalty is the total variation of the displacements, which permits jumps at the outline of a near object.

    Source: Rueckert et al. 1999, "Nonrigid registration using free-form deformations".

    Args:
        shape: (N, ...); the rest follows from `size`.
        size: (h, w) of a frame.
        ratio: Scene px per detector px.
        spacing: Spacing of the control points, detector px.
        weight: Weight of the total variation, nats per px of a step and px of its length.

    Raises:
        ValueError: `spacing` or `weight` is out of range.
    """

    example_shape = (3, 3, 3)
    example_options: ClassVar = {"size": (12, 15), "spacing": 5}
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
        weight: float = DEFAULT_TV_WEIGHT,
    ) -> None:
        super().__init__((shape[0], *size, 2), neutral)
        if not 2 <= spacing <= MAX_SPACING:
            raise ValueError(f"spacing must be 2 to {MAX_SPACING:g} px, not {spacing}")
        if not 0 <= weight < math.inf:
            raise ValueError(f"weight must be a number of at least 0, not {weight}")
        self.size, self.ratio, self.spacing = (size[0], size[1]), ratio, spacing
        self.preconditioning_scale = PARAMETER_SCALE / spacing
        self.n_samples_affected = (SPLINE_EXTENT * spacing * ratio) ** 2
        self.register_buffer("weight", torch.tensor(float(weight)))
        still = project_pixels(torch.eye(3)[None], self.size).expand(self.shape)
        self.register_buffer("start", still, persistent=False)
        for name, side in zip(("down", "across"), size, strict=True):
            self.register_buffer(name, _spline_basis(side, spacing * ratio), persistent=False)
        self.values = nn.Parameter(torch.zeros(shape[0] - 1, 2, self.down.shape[1], self.across.shape[1]))

    def forward(self) -> Tensor:
        """Sampling points: those of the homographies plus displacements, (N, h, w, 2), px."""
        moved = self.down @ (self.ratio * self.preconditioning_scale * self.values) @ self.across.mT
        first, others = self.start.permute(0, 3, 1, 2).tensor_split([1])
        return torch.cat((first, others + moved)).permute(0, 2, 3, 1)

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent homographies (N, 3, 3) without displacements, or sampling points (N, h, w, 2) by displacements."""
        if value.shape[1:] == (3, 3):
            self.start = project_pixels(value.to(self.start.device).double(), self.size).to(self.start)
            self.values.zero_()
            return
        own = (value.to(self.start) - self.start).permute(0, 3, 1, 2)[1:].double()
        down, across = (torch.linalg.pinv(each.double()) for each in (self.down, self.across))
        self.values.copy_(down @ own @ across.mT / (self.ratio * self.preconditioning_scale))

    def penalty(self) -> Tensor | None:
        """Smoothed total variation `weight Σ s |d|` of differences d between control points s px apart, nats."""
        squared = squared_gradient(self.preconditioning_scale * self.values).sum(1)
        rounded = squared / (torch.sqrt(squared + TV_SMOOTHING**2) + TV_SMOOTHING)
        return self.weight * self.spacing * rounded.sum()


def _spline_basis(side: int, spacing: float) -> Tensor:
    """Cubic B-splines `spacing` px apart, the second about the first pixel, at each pixel: (side, count)."""
    count = math.ceil((side - 1) / spacing) + 3
    at = torch.arange(side, dtype=torch.float64)[:, None] / spacing - (torch.arange(count) - 1)
    t = (2 - at.abs()).clamp(min=0)
    return (t**3 / 6 - 4 / 6 * (t - 1).clamp(min=0) ** 3).float()
