"""Thermal lag: a pixel takes its time to follow the flux."""

from __future__ import annotations

from typing import ClassVar, Literal

import torch
from torch import Tensor

from deepir.operators.base import Operator, Shape
from deepir.operators.path import Path
from deepir.registry import register

SHORTEST = 1e-6  # time constant below which a pixel follows at once, in steps


@register("operator", "lag")
class Lag(Operator):
    """What a pixel of time constant `tau` shows of a flux, `tau dy/dt = x - y`.

    (M, C, h, w) -> (N, C, h, w), where M = (N - 1) `substeps` + 1 are the instants at which the flux is given, from
    the first frame to the last. Between two of them it is linear, and the solution exact:
    `y_i = a y_(i-1) + (1 - a - b) x_(i-1) + b x_i`, `a = exp(-dt / tau)`, `b = 1 - (1 - a) tau / dt`. Before the first
    the pixel had settled, `y_0 = x_0`.

    The slot `tau`, in ms, is (1, C, h, w). Saragadam et al. 2021, the step response in "Sensor modeling".
    """

    neutral: ClassVar = {"tau": 0.0}

    def __init__(self, fps: float | None = None, *, substeps: int = 4, start: Literal["rest", "moving"] = "rest", readout: float = 0.0) -> None:
        """`fps`: frames a second.

        Raises:
            ValueError: A rate that is missing or not positive, or no step.
        """
        super().__init__()
        if fps is None or not fps > 0:
            raise ValueError("the frame rate is needed, in frames a second: data.fps=60")
        if not 1 <= substeps <= 100:
            raise ValueError(f"substeps must be 1 to 100, not {substeps}")
        if not 0 <= readout <= 1:
            raise ValueError(f"readout must be 0 to 1, not {readout}")
        self.readout = readout
        self.path = Path(substeps, substeps if start == 'moving' else 0)
        self.duration = 1000 / (fps * substeps)

    def slots(self, x_shape: Shape, n_frames: int) -> dict[str, Shape]:
        """`tau`: (1, C, h, w)."""
        return {"tau": (1, *x_shape[1:])}

    def out_shape(self, x_shape: Shape, n_frames: int) -> Shape:
        """(N, C, h, w)."""
        return ((x_shape[0] - 1 - self.path.lead) // self.path.steps + 1, *x_shape[1:])

    def forward(self, x: Tensor, *, tau: Tensor) -> Tensor:  # type: ignore[override]
        """Follow the flux from instant to instant.

        Raises:
            ValueError: The number of instants does not fit the number of steps.
        """
        if (len(x) - 1 - self.path.lead) % self.path.steps:
            raise ValueError(f"lag: {len(x)} instants, but {self.path.steps} for each frame after the first are needed")
        weights = self._weights(tau[0].double())
        kept, *of_flux = (weight.to(x.dtype) for weight in weights)
        shown, before = [x[0]], x[0]
        for earlier, before, now in zip((x[0], *x), x, x[1:], strict=False):
            given = sum(weight * flux for weight, flux in zip(of_flux, (earlier, before, now), strict=True))
            shown.append(kept * shown[-1] + given)
        return self._read(torch.stack(shown))

    def _read(self, shown: Tensor) -> Tensor:
        """The frames of what is shown at all instants."""
        if not self.readout:
            return shown[self.path.lead :: self.path.steps]
        height, last = shown.shape[-2], len(shown) - 1
        rows = torch.arange(height, device=shown.device)
        early = self.readout * self.path.steps * (1 - (rows + 1) / height)
        frames = torch.arange(self.path.lead, len(shown), self.path.steps, device=shown.device)
        at = (frames[:, None] - early).clamp(min=0)
        first = at.long().clamp(max=max(last - 1, 0))
        part = (at - first).to(shown.dtype)[..., None, None]
        rows_of = shown.movedim(2, 1)  # (instants, h, C, w)
        seen = torch.lerp(rows_of[first, rows], rows_of[(first + 1).clamp(max=last), rows], part)
        return seen.movedim(1, 2)

    def _weights(self, tau: Tensor) -> tuple[Tensor, ...]:
        """Of what was shown an instant ago, and of the flux at the last three instants."""
        step = self.duration / tau.clamp(min=SHORTEST * self.duration)
        kept = torch.exp(-step)
        slope = 1 - (1 - kept) / step
        bend = (1 - 2 * slope / step - slope) / 2
        return kept, bend, 1 - kept - slope - 2 * bend, slope + bend

    def valid(self, mask: Tensor, *, tau: Tensor) -> Tensor:  # type: ignore[override]
        """Samples that have seen nothing but valid flux so far."""
        return mask.cummin(0).values[self.path.lead :: self.path.steps]

    @classmethod
    def example(cls) -> tuple[Operator, Tensor, dict[str, Tensor]]:
        """Three frames of 4 x 5 px, two steps each."""
        generator = torch.Generator().manual_seed(0)
        x, tau = (torch.rand(n, 1, 4, 5, generator=generator, dtype=torch.float64) for n in (5, 1))
        return cls(60.0, substeps=2), x, {"tau": 5 + 10 * tau}
