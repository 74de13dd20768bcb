"""Camera motion: with few parameters (shift, rigid, affine, homography, or what the frames ask for), and dense."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from deepir.arrays.windows import squared_gradient
from deepir.fields.base import Field, Shape
from deepir.operators.motion_models import AUTO, PARAMETERS, increment, nearest_rigid, parameters_of
from deepir.operators.warp import project_pixels
from deepir.registry import register

#: Displacement per unit of a parameter, detector px times the square root of the samples it affects. The curvature of
#: the misfit in a shift is about the number of samples times that in a scene pixel times its squared gradient.
PARAMETER_SCALE = 10.0
RIGID_TOLERANCE = 1e-3  # deviation from a rigid motion at the corners of the frame that counts as rounding, px
#: Default weight of the total variation of displacements, nats per px of a step and px of its length; without texture
#: nothing else determines them.
DEFAULT_TV_WEIGHT = 1.0
MAX_SPACING = 1000.0  # largest spacing of control points, px
TV_SMOOTHING = 0.05  # smoothing length of the total variation, px between control points
SPLINE_EXTENT = 0.479  # sum of the squares of a cubic B-spline over one axis, in spacings of its control points


class Motion(Field):
    """Parametric motion: homographies (N, 3, 3) from frame to scene, px; frame 0 is the identity if it is `anchored`.

    Parameters are displacements at the edge of the frame.

    Args:
        shape: (N, 3, 3).
        neutral: Unused.
        size: (h, w) of a frame, scene px.
        ratio: Scene px per detector px.
        anchored: Whether frame 0 defines where the scene is; else it is an unknown as the others are.
    """

    example_shape = (3, 3, 3)
    example_options: ClassVar = {"size": (60, 80)}

    def __init__(
        self, shape: Shape, neutral: float = 0.0, *, size: tuple[int, int], ratio: float = 1.0, anchored: bool = True
    ) -> None:
        super().__init__(shape, neutral)
        self.n_fixed = int(anchored)
        self.radius = math.hypot(*size) / 2
        self.n_samples_affected = size[0] * size[1]
        self.preconditioning_scale = PARAMETER_SCALE * ratio / math.sqrt(self.n_samples_affected)
        self.values = nn.Parameter(torch.zeros(shape[0] - self.n_fixed, self.n_parameters))

    def forward(self) -> Tensor:
        """Identity for frame 0, then the parameters' homographies."""
        moved = self.matrices(self.preconditioning_scale * self.values)
        if not self.n_fixed:
            return moved
        first = torch.eye(3, dtype=moved.dtype, device=moved.device)[None]
        return torch.cat((first, moved))

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent homographies (N, 3, 3) relative to frame 0, projected onto the model."""
        self.values.copy_(self.parameters_of(self.free_motions(value)) / self.preconditioning_scale)

    def free_motions(self, value: Tensor) -> Tensor:
        """Those of homographies (N, 3, 3) that are unknowns, relative to frame 0 where that is anchored."""
        value = value.double()
        relative = torch.linalg.solve(value[:1], value[1:]) if self.n_fixed else value
        return relative / relative[:, 2:, 2:]

    def matrices(self, p: Tensor) -> Tensor:
        """(N - 1, n_parameters) parameters in px -> (N - 1, 3, 3)."""
        return increment(self.kind, p, self.radius)

    def parameters_of(self, t: Tensor) -> Tensor:
        """The inverse of `matrices`, projected onto the model; `t[:, 2, 2]` is one."""
        return parameters_of(self.kind, t, self.radius)

    @property
    def kind(self) -> str:
        """The motion model, a key of `deepir.operators.motion_models.PARAMETERS`."""
        return str(self.model)

    @property
    def n_parameters(self) -> int:
        """Number of parameters of a frame."""
        return PARAMETERS[self.kind]


@register("field", "shift")
class Shift(Motion):
    """Translation, 2 parameters a frame."""

    model = "shift"


@register("field", "rigid")
class Rigid(Motion):
    """Rotation about the frame's centre and translation, 3 parameters a frame."""

    model = "rigid"


@register("field", "affine")
class Affine(Motion):
    """Any linear map and translation, 6 parameters a frame."""

    model = "affine"


@register("field", "homography")
class Homography(Motion):
    """Any perspective map, 8 parameters a frame."""

    model = "homography"


@register("field", "auto")
class Auto(Motion):
    """Rigid motion, or homographies if the initial motion is not rigid."""

    model = AUTO
    n_parameters = PARAMETERS["homography"]
    uses_homography: Tensor

    def __init__(self, shape: Shape, neutral: float = 0.0, **context: Any) -> None:
        super().__init__(shape, neutral, **context)
        self.register_buffer("uses_homography", torch.tensor(False))

    @property
    def kind(self) -> str:
        """The present motion model."""
        return "homography" if self.uses_homography else "rigid"

    @torch.no_grad()
    def init_from(self, value: Tensor) -> None:
        """Represent homographies (N, 3, 3) relative to frame 0, and select the model."""
        relative = self.free_motions(value)
        bend = (relative - nearest_rigid(relative)).abs()
        bend[:, :, :2] *= self.radius
        bend[:, 2] *= self.radius
        self.uses_homography.fill_(bool((bend > RIGID_TOLERANCE).any()))
        super().init_from(value)

    @torch.no_grad()
    def switch_to_homography(self) -> None:
        """Switch from rigid motion to homographies at the present value."""
        now = self()[self.n_fixed :].double()
        self.uses_homography.fill_(True)
        self.values.copy_(self.parameters_of(now) / self.preconditioning_scale)

    def matrices(self, p: Tensor) -> Tensor:
        """Homographies; the last parameters of a rigid motion are unused."""
        return super().matrices(p[:, : PARAMETERS[self.kind]])

    def parameters_of(self, t: Tensor) -> Tensor:
        """The inverse of `matrices`; the last parameters of a rigid motion are zero."""
        found = super().parameters_of(t)
        return F.pad(found, (0, self.n_parameters - found.shape[1]))


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
