"""Gain and offset of single pixels whose pattern has a power spectrum, not only a variance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Tensor

from deepir.fields.sensor_maps import GaussianMap
from deepir.multiview.gradients import Edges, WhiteParts

#: Least spatial frequency of the lowest band, cycles/px; bands are octaves along each axis.
LOWEST_FREQUENCY = 1 / 128
#: Power of a band at least, relative to the noise of the estimate there: a power of zero would stay zero.
MIN_POWER = 1e-3


class ColouredPixels(WhiteParts):
    """The pixels' part of the pattern with a radial power spectrum, estimated from the pattern itself.

    Many cameras' patterns are not white: optics, read-out and compressed video give neighbouring pixels much in common,
    and a white prior then takes most of what is coarser than a few pixels away. The pattern at the frames' mean level
    is `C x`, with `C` diagonal in the cosine transform and x white; the gain is as in `WhiteParts`.
    """

    def __init__(
        self, along: tuple[int, ...], pair: list[GaussianMap | None], level: float, size: Sequence[int]
    ) -> None:
        super().__init__(along, pair, level, size)
        #: Of each axis the octave of each coefficient's frequency, from the lowest.
        self.octaves = [
            torch.from_numpy(np.log2(np.maximum(np.arange(side) / max(2 * side * LOWEST_FREQUENCY, 1), 1)))
            for side in size
        ]
        y, x = (torch.from_numpy(2 - 2 * np.cos(np.pi * np.arange(side) / side)) for side in size)
        #: Eigenvalues of the operator differences^T differences, (h, w).
        self.curvature = y[:, None] + x
        #: Power spectrum at each coefficient, in counts squared; None: flat, of the parts' own variance.
        self.power: Tensor | None = None

    def _amplitude(self) -> Tensor:
        """Standard deviation of each coefficient of the pattern at the level, (h, w)."""
        if self.power is None:
            return torch.full_like(self.curvature, super().root()[0])
        return self.power.sqrt()

    def root(self) -> tuple[float, float, float]:
        """As in `WhiteParts`, but for the amplitude of the pattern at the level, which the spectrum holds."""
        whole, shared, own = super().root()
        return (1.0, shared / whole, own) if whole else (0.0, 0.0, 0.0)

    def values(self, white: Tensor) -> Tensor:
        """Of gain and level, (2, h, w)."""
        first, second = white.view(self.shape)
        pattern = _inverse_cosines(self._amplitude() * first)
        _, shared, own = self.root()
        return torch.stack((shared * pattern + own * second, pattern))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `values`."""
        gain, level = pattern
        _, shared, own = self.root()
        first = self._amplitude() * _cosines(level + shared * gain)
        return torch.stack((first, own * gain)).flatten()

    def whiten(self, values: Tensor) -> Tensor:
        """The inverse of `values`."""
        gain, level = values
        _, shared, own = self.root()
        amplitude = self._amplitude()
        first = torch.where(amplitude > 0, _cosines(level) / amplitude.clamp(min=1e-300), 0)
        second = (gain - shared * level) / own if own else torch.zeros_like(gain)
        return torch.stack((first, second)).flatten()

    def diagonal(self, information: Tensor) -> Tensor:
        """Of the normal matrix: each coefficient's curvature under mean weights, each pixel's own for the gain."""
        aa, ab, bb = information
        _, shared, own = self.root()
        edges = float((bb + 2 * shared * ab + shared**2 * aa).mean()) / 4  # a pixel has four edges
        first = self._amplitude().square() * edges * self.curvature
        return 1 + torch.stack((first, own**2 * aa)).flatten()

    def update_strengths(self, edges: Edges, pattern: Tensor, values: Tensor) -> None:
        """The gain's share as in `WhiteParts`; then the power spectrum of the pattern at the level.

        The noise of the estimate is what the two halves of the frames differ by.
        """
        super().update_strengths(edges, pattern, values)
        if any(part and part.sigma_is_fixed for part in self.pair):
            return
        weight = float(edges.information(self.along)[2].mean()) / 4
        curvature = self.curvature.clamp(min=1e-12)
        modelled = 1 / (weight * curvature)
        noise = (_cosines(edges.half_difference(pattern)) * modelled).square()
        before = self._amplitude().square()
        unshrunk = (_cosines(values[1]) * (1 + modelled / before.clamp(min=1e-300))).square()
        found = self._band_means(unshrunk)
        spoilt = self._band_means(noise).clamp(min=1e-300)
        power = (found - spoilt).clamp(min=MIN_POWER * spoilt)
        self.power = self._interpolated(power * self._band_means(modelled) / spoilt)
        offset = self.pair[1]
        if offset is not None and self.pair[0] is None:
            offset.sigma.fill_(float(self._interpolated(power).mean()) ** 0.5)

    def _band_means(self, spectrum: Tensor) -> Tensor:
        """Means of a spectrum (h, w) over octaves along y and along x; what is constant along an axis is left out."""
        for axis in (0, 1):
            index = self.octaves[axis].long()[1:]
            others = spectrum.narrow(axis, 1, len(index))
            count = torch.zeros(int(index.max()) + 1).index_add(0, index, torch.ones(len(index)))
            shape = [len(count) if each == axis else side for each, side in enumerate(others.shape)]
            total = torch.zeros(shape, dtype=spectrum.dtype).index_add(axis, index, others)
            spectrum = total / count.clamp(min=1).unsqueeze(1 - axis)
        return spectrum

    def _interpolated(self, bands: Tensor) -> Tensor:
        """The spectrum (h, w) that is log-linear between the octaves' centres."""
        logs = bands.log()
        for axis in (0, 1):
            place = (self.octaves[axis] - 0.5).clamp(0, logs.shape[axis] - 1)
            low = place.long().clamp(max=max(logs.shape[axis] - 2, 0))
            high = (low + 1).clamp(max=logs.shape[axis] - 1)
            share = (place - low).unsqueeze(1 - axis)
            logs = (1 - share) * logs.index_select(axis, low) + share * logs.index_select(axis, high)
        return logs.exp()


def _cosines(maps: Tensor) -> Tensor:
    """The orthonormal cosine transform of a map (h, w)."""
    return torch.from_numpy(dctn(maps.cpu().numpy(), norm="ortho")).to(maps)


def _inverse_cosines(coefficients: Tensor) -> Tensor:
    return torch.from_numpy(idctn(coefficients.cpu().numpy(), norm="ortho")).to(coefficients)
