"""Thermal lag of the detector."""

from __future__ import annotations

from typing import ClassVar

import torch
from torch import Tensor

from deepir.operators.base import Operator, Shape, Trajectory
from deepir.registry import register

MIN_TIME_CONSTANT = 1e-6  # smallest time constant, in time steps; below, a pixel follows at once


@register("operator", "lag")
class Lag(Operator):
    """First-order response of pixels, `tau dy/dt = x - y`; (M, C, h, w) -> (N, C, h, w).

    The flux is given at M instants, `substeps` per frame, the last at its readout, and one initial instant. It is
    interpolated by parabolas, for which the solution is exact; piecewise constant or linear flux needs many more
    sub-steps, as its error resembles a longer time constant.

    Slots: `tau`, ms, (1, C, h, w); `moving`, (1, 1, 1, 1), the camera velocity before the first frame relative to that
    of the extrapolated trajectory: 0 at rest, with settled pixels, 1 in motion.

    Source: Saragadam et al. 2021, "Sensor modeling", step response.
    """

    temporal = keeps_grid = True
    neutral: ClassVar = {"tau": 0.0, "moving": 0.0}
    example_shape = (7, 1, 4, 5)
    example_options: ClassVar = {"fps": 60.0, "substeps": 2}

    def __init__(self, fps: float | None = None, *, substeps: int = 4, readout: float = 0.0) -> None:
        """Discretise the response.

        Args:
            fps: Frame rate, Hz.
            substeps: Instants per frame.
            readout: Fraction of the frame time during which rows are read in turn; the motion of a frame is that at
                its last row.

        Raises:
            ValueError: An argument is missing or out of range.
        """
        super().__init__()
        if fps is None or not fps > 0:
            raise ValueError("the rate of the frames is needed, for example data.fps=60")
        if not 1 <= substeps <= 100:
            raise ValueError(f"substeps must be 1 to 100, not {substeps}")
        if not 0 <= readout <= 1:
            raise ValueError(f"readout must be 0 to 1, not {readout}")
        self.trajectory = Trajectory(substeps, n_before=substeps)
        self.duration, self.readout = 1000 / (fps * substeps), readout

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`tau`: (1, C, h, w); `moving`: (1, 1, 1, 1)."""
        return {"tau": (1, *x_shape[1:]), "moving": (1, 1, 1, 1)}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, h, w)."""
        return (self.trajectory.frames(x_shape[0]), *x_shape[1:])

    def forward(self, x: Tensor, *, tau: Tensor, moving: Tensor) -> Tensor:  # type: ignore[override]
        """Integrate the response over the instants.

        Before the first frame the flux is interpolated between that of a camera at rest and of one in motion by
        `moving`.

        Raises:
            ValueError: The instants are not those of whole frames.
        """
        if self.trajectory.count(self.trajectory.frames(len(x))) != len(x):
            raise ValueError(
                f"lag: {len(x)} instants are not {self.trajectory.steps} for each frame and one to begin with"
            )
        kept, *weights = (weight.to(x.dtype) for weight in self._weights(tau[0].double()))
        lead, share = self.trajectory.n_before, moving[0].to(x.dtype)
        rest = x[lead]
        seen = [*(torch.lerp(rest, each, share) for each in x[:lead]), *x[lead:]]
        shown, earlier, before = [seen[0]], seen[0], seen[0]
        for now in seen[1:]:
            given = weights[0] * earlier + weights[1] * before + weights[2] * now
            shown.append(kept * shown[-1] + given)
            earlier, before = before, now
        return self._read(torch.stack(shown))

    def valid(self, mask: Tensor, *, tau: Tensor, moving: Tensor) -> Tensor:  # type: ignore[override]
        """Samples of pixels with valid flux at all instants so far."""
        return mask.cummin(0).values[self.trajectory.n_before :: self.trajectory.steps]

    def _weights(self, tau: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Weights of the last response and of the flux two and one instants ago and now; their sum is one."""
        step = self.duration / tau.clamp(min=MIN_TIME_CONSTANT * self.duration)
        kept = torch.exp(-step)
        # What a pixel makes of a flux that rises as t, and as t², from 0 to 1 during the step.
        linear = 1 - (1 - kept) / step
        square = 1 - 2 * linear / step
        bend = (square - linear) / 2
        return kept, bend, 1 - kept - linear - 2 * bend, linear + bend

    def _read(self, shown: Tensor) -> Tensor:
        """The frames, of what is shown at all instants; rows are read between two of them."""
        if not self.readout:
            return shown[self.trajectory.n_before :: self.trajectory.steps]
        height, latest = shown.shape[-2], max(len(shown) - 2, 0)
        rows = torch.arange(height, device=shown.device)
        ends = torch.arange(self.trajectory.n_before, len(shown), self.trajectory.steps, device=shown.device)
        at = ends[:, None] - self.readout * self.trajectory.steps * (1 - (rows + 1) / height)
        first = at.clamp(min=0).long().clamp(max=latest)  # (N, h)
        part = (at.clamp(min=0) - first).to(shown.dtype)[..., None, None]
        by_row = shown.movedim(2, 1)
        following = (first + 1).clamp(max=len(shown) - 1)
        return torch.lerp(by_row[first, rows], by_row[following, rows], part).movedim(1, 2)

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three frames, two steps each, time constants of 5 to 15 ms."""
        operator, x, slots = super().example()
        return operator, x, slots | {"tau": 5 + 10 * slots["tau"]}
