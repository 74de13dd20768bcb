"""A moving camera that reads its rows one after the other."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.kernels.threads import MIN_DEPTH, is_compiled
from deepir.operators.base import Operator, Shape
from deepir.operators.warp import Warp
from deepir.registry import register


@register("operator", "rolling_shutter")
class RollingShutter(Warp):
    """A warp whose rows are each of their own time, between the frames before and after.

    The slot `readout`, (1, 1, 1, 1), is the time from the first row to the last one, in intervals between frames; it is
    negative if the rows are read upwards. The slot `motion`, (N, 3, 3), is that of the middle row of each frame;
    between these, and beyond the first and the last, it changes evenly.
    """

    neutral: ClassVar = {"readout": 0.0}

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`motion`: (N, 3, 3); `readout`: (1, 1, 1, 1)."""
        return {"motion": (n_frames, 3, 3), "readout": (1, 1, 1, 1)}

    def fits(self, slot: str, wanted: Shape, found: Shape) -> bool:
        """Homographies alone: points are of every row already."""
        return found == wanted

    def forward(self, x: Tensor, *, motion: Tensor, readout: Tensor) -> Tensor:  # type: ignore[override]
        """Sample the canvas where each row looks."""
        return super().forward(x, motion=self.points(motion, readout))

    def adjoint(self, y: Tensor, x_shape: Shape, *, motion: Tensor, readout: Tensor) -> Tensor:  # type: ignore[override]
        """That of the warp to these points."""
        if not is_compiled(y):
            return Operator.adjoint(self, y, x_shape, motion=motion, readout=readout)
        return super().adjoint(y, x_shape, motion=self.points(motion, readout))

    def valid(self, mask: Tensor, *, motion: Tensor, readout: Tensor) -> Tensor:  # type: ignore[override]
        """That of the warp to these points."""
        return super().valid(mask, motion=self.points(motion, readout))

    def points(self, motion: Tensor, readout: Tensor) -> Tensor:
        """The points (x, y) that pixels look at, (N, h, w, 2), px from the frame's centre."""
        motion = motion.double()
        y, x = (torch.arange(side).to(motion) - (side - 1) / 2 for side in self.size)
        time = readout.double().flatten() * y / max(self.size[0] - 1, 1)
        steps = motion.diff(dim=0) if len(motion) > 1 else torch.zeros_like(motion)
        before, after = (torch.cat(each)[: len(motion)] for each in ((steps[:1], steps), (steps, steps[-1:])))
        slope = torch.where(time[:, None, None] > 0, after[:, None], before[:, None])  # (N, h, 3, 3)
        t = (motion[:, None] + time[:, None, None] * slope)[..., None]
        px, py, pz = (t[:, :, i, 0] * x + t[:, :, i, 1] * y[:, None] + t[:, :, i, 2] for i in range(3))
        nearness = pz.clamp(min=MIN_DEPTH).reciprocal()
        return torch.stack((px * nearness, py * nearness), -1)
