"""Parts of gain and offset in whitened coordinates: well conditioned where data hardly separate them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.arrays.statistics import robust_std
from deepir.estimation.variance_components import MAX_SIGMA_RATIO, estimate_sigmas, high_pass
from deepir.fields.sensor_maps import GaussianMap
from deepir.multiview.gradients import Edges

LOW = 0.05  # least strength, in the most: what falls to nothing does not come back


class WhiteParts:
    """Gain and offset of the pixels, the columns or the rows, in white coordinates.

    The first is what the pattern at the frames' level has of them, the second what then is open of the gain: with
    a pedestal of 8,000 counts gain and offset themselves are next to the same.
    """

    def __init__(
        self, along: tuple[int, ...], pair: list[GaussianMap | None], level: float, size: Sequence[int]
    ) -> None:
        self.along, self.pair, self.level = along, pair, level
        self.shape = (2, *(1 if axis in along else side for axis, side in zip((-2, -1), size, strict=True)))

    def root(self) -> tuple[float, float, float]:
        """The triangle of Cholesky of the prior covariance of (pattern at the level, gain)."""
        gain, offset = (float(part.sigma) if part else 0.0 for part in self.pair)
        whole = ((self.level * gain) ** 2 + offset**2) ** 0.5
        return (whole, self.level * gain**2 / whole, gain * offset / whole) if whole else (0.0, 0.0, 0.0)

    def values(self, white: Tensor) -> Tensor:
        """Of gain and level, (2, h or 1, w or 1)."""
        first, second = white.view(self.shape)
        a, b, c = self.root()
        return torch.stack((b * first + c * second, a * first))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `values`, as a map (2, h, w)."""
        gain, level = pattern.sum(self.along, keepdim=True) if self.along else pattern
        a, b, c = self.root()
        return torch.stack((a * level + b * gain, c * gain)).flatten()

    def whiten(self, values: Tensor) -> Tensor:
        """The inverse of `values`; zero for what has no strength."""
        gain, level = values
        a, b, c = self.root()
        first = level / a if a else torch.zeros_like(level)
        return torch.stack((first, (gain - b * first) / c if c else torch.zeros_like(gain))).flatten()

    def diagonal(self, information: Tensor) -> Tensor:
        """Of the normal matrix, from its blocks for gain and level."""
        aa, ab, bb = information
        a, b, c = self.root()
        return 1 + torch.stack((a * a * bb + 2 * a * b * ab + b * b * aa, c * c * aa)).flatten()

    def bound(self, level: Tensor, unit: float) -> None:
        """Let no strength explain more than twice the pattern (h, w) at the frames' level, a gain that in `unit`.

        Gain and offset would else grow, and cancel each other there, where scenes are alike.
        """
        for part, size in zip(self.pair, (unit, 1.0), strict=True):
            if part:
                part.max_sigma.fill_(MAX_SIGMA_RATIO * robust_std(high_pass(level, part)) / max(size, 1e-30))

    def update_strengths(self, edges: Edges, pattern: Tensor, values: Tensor) -> None:
        """The likeliest, all other parts held; `pattern` (2, h, w) is that of all of them."""
        aa, ab, bb = edges.information(self.along).flatten(1)
        level = self.level
        information = torch.stack((aa + 2 * level * ab + level**2 * bb, ab + level * bb, bb))
        free = [i for i, part in enumerate(self.pair) if part and not part.sigma_is_fixed]
        sigma, most = (
            torch.stack(
                [getattr(part, name).double() if part else values.new_zeros(()) for part in self.pair]
            )
            for name in ("sigma", "max_sigma")
        )
        means = self.split(values).flatten(1)
        found = estimate_sigmas(information, means, sigma, most, free)
        for i in free:
            self.pair[i].sigma.copy_(found[i].clamp(min=LOW * most[i]))  # type: ignore[union-attr]

    def split(self, values: Tensor) -> Tensor:
        """Gain and offset, from gain and level."""
        return torch.stack((values[0], values[1] - self.level * values[0]))
