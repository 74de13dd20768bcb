"""Gradients that frames of different scenes share, and the maps of gain and offset that they tell, whitened."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
import torch.nn.functional as F
from scipy.fft import dctn, idctn
from torch import Tensor

from deepir.arrays.statistics import robust_std
from deepir.estimation.variance_components import MAX_SIGMA_RATIO, estimate_sigmas, high_pass
from deepir.fields.sensor_maps import GaussianMap

SHARE = 0.25  # what a gradient counts: its neighbours say much the same
LEAST = 1e-6  # of a frame's squared scale, in that of the typical frame
AXES = (-1, -2)
#: Degrees of freedom that are tried for a frame's gradients: Cauchy's, and two with lighter tails.
FREEDOMS = (1.0, 2.0, 4.0)
SAMPLES = 20_000  # gradients of a frame by which its distribution is chosen
SCALE_STEPS = 10
LOW = 0.05  # least strength, in the most: what falls to nothing does not come back
LOWEST_FREQUENCY = 1 / 128  # least spatial frequency of the lowest band, cycles/px; bands are octaves along each axis
#: Power of a band at least, relative to the noise of the estimate there: a power of zero would stay zero.
MIN_POWER = 1e-3


class Edges:
    """Sums over frames (N, h, w) at their edges along x and along y; `usable`, of the same shape, says which count.

    A pattern is (2, h, w): of the gain, and of the frames' mean `level`, `offset + level * gain`. The data say the
    latter well even where they do not separate gain and offset. `shared` (h, w) is a first estimate of it.
    """

    def __init__(self, frames: Tensor, usable: Tensor, shared: Tensor) -> None:
        self.frames, self.usable = frames, usable
        self.level = float(frames[usable].mean(dtype=torch.float64))
        #: Variance of the pattern's gradients as it is found: where it follows a frame, the frame leaves no residual.
        self.doubt = [frames.new_zeros(frames.shape[1:], dtype=torch.float64).diff(dim=axis) for axis in AXES]
        # The likelihood has many optima. From a pattern of zero a pixel far off its neighbours would stay there, for
        # all its gradients would count for little.
        pattern = torch.stack((torch.zeros_like(shared), shared)).double()
        start = [pattern.diff(dim=axis) for axis in AXES]
        #: Root mean square of the pattern's gradients at the start.
        self.typical = float(torch.cat([each[1].flatten() for each in start]).square().mean().sqrt())
        #: Squared scale of each frame's gradients.
        self.scales = torch.stack([
            torch.cat([squares[counts] for *_, squares, counts in self._seen(k, start)]).median()
            for k in range(len(frames))
        ])  # fmt: skip
        #: Degrees of freedom of each frame's Student distribution.
        self.freedom = [FREEDOMS[0]] * len(frames)
        self._weigh(start)

    def weigh(self, pattern: Tensor) -> None:
        """Weigh each gradient by what the pattern leaves of it."""
        self._weigh([pattern.diff(dim=axis) for axis in AXES])

    def _weigh(self, gradients: list[Tensor]) -> None:
        self.scales.clamp_(min=max(LEAST * float(self.scales.median()), 1e-30))
        #: For each axis the normal matrix (aa, ab, bb) of the gradients of gain (a) and level's pattern (b), and the
        #: right-hand side (a, b).
        self.sums = [each.new_zeros(5, *each.shape[1:]) for each in gradients]
        #: The same of the first half of the frames.
        self.half = [torch.zeros_like(sums) for sums in self.sums]
        for k in range(len(self.frames)):
            if k == len(self.frames) // 2:
                self.half = [sums.clone() for sums in self.sums]
            seen = list(self._seen(k, gradients))
            squares = torch.cat([each[counts] for *_, each, counts in seen])
            self.freedom[k], self.scales[k] = likeliest_tail(squares, float(self.scales[k]))
            for sums, (step, level, square, counts) in zip(self.sums, seen, strict=True):
                weight = (self.freedom[k] + 1) * SHARE * counts / (self.freedom[k] * self.scales[k] + square)
                of_gain = weight * level
                terms = of_gain * level, of_gain, weight, of_gain * step, weight * step
                for i, term in enumerate(terms):
                    sums[i] += term
        known = torch.stack([_about(sums[2], axis) for axis, sums in zip(AXES, self.sums, strict=True)]).sum(0)
        self.doubt = [_ends(SHARE / known.clamp(min=1e-30), axis) for axis in AXES]

    def normal(self, pattern: Tensor) -> Tensor:
        """The normal matrix times a pattern."""
        total = torch.zeros_like(pattern)
        for axis, (aa, ab, bb, *_) in zip(AXES, self.sums, strict=True):
            gain, level = pattern.diff(dim=axis)
            total += _adjoint(torch.stack((aa * gain + ab * level, ab * gain + bb * level)), axis)
        return total

    def score(self) -> Tensor:
        """The right-hand side of the normal equations, (2, h, w)."""
        return torch.stack([_adjoint(sums[3:], axis) for axis, sums in zip(AXES, self.sums, strict=True)]).sum(0)

    def half_difference(self, pattern: Tensor) -> Tensor:
        """Half the difference of what both halves of the frames add to the pattern's level, as its score (h, w).

        It holds no pattern, only what the scenes and the noise leave in an estimate from all frames.
        """
        total = torch.zeros_like(pattern[1])
        for axis, whole, first in zip(AXES, self.sums, self.half, strict=True):
            gain, level = pattern.diff(dim=axis)
            rest, early = (b - ab * gain - bb * level for _, ab, bb, _, b in (whole, first))
            weight = whole[2].mean()
            shares = [(each / sums[2].mean()) for each, sums in ((early, first), (rest - early, whole - first))]
            total += _adjoint(weight * (shares[0] - shares[1]) / 2, axis)
        return total

    def information(self, along: tuple[int, ...]) -> Tensor:
        """Diagonal blocks (aa, ab, bb) of the normal matrix, of values constant `along` axes, (3, h or 1, w or 1)."""
        total = torch.zeros(())
        for axis, sums in zip(AXES, self.sums, strict=True):
            if axis not in along:  # else it has no gradient
                each = _about(sums[:3], axis)
                total = total + (each.sum(along, keepdim=True) if along else each)
        return total

    def misfit(self, pattern: Tensor) -> Tensor:
        """How far each pixel (h, w) is from what its neighbours and the pattern let expect, in the mean of all frames.

        In nats; of a Cauchy number it is 2 log 2. It is that of the second best edge: next to a defective pixel, one is
        bad.
        """
        sums = [torch.zeros_like(each) for each in self.doubt]
        gradients = [pattern.diff(dim=axis) for axis in AXES]
        for k in range(len(self.frames)):
            for i, (_, _, square, counts) in enumerate(self._seen(k, gradients)):
                freedom = self.freedom[k]
                nats = (freedom + 1) / 2 * (square / (freedom * self.scales[k])).log1p()
                sums[i] += counts * nats
        each = []
        for axis, total in zip(AXES, sums, strict=True):
            side, outermost = total.shape[axis], [total.narrow(axis, i, 1) for i in (0, -1)]
            padded = torch.cat((outermost[0], total, outermost[1]), axis)
            each += [padded.narrow(axis, i, side + 1) for i in (0, 1)]
        return torch.stack(each).sort(0).values[1] / len(self.frames)

    def _seen(self, k: int, gradients: list[Tensor]) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """Along each axis frame k's gradients, levels, squares of what the pattern leaves of them, and which count."""
        frame = self.frames[k].double()
        for axis, doubt, (gain, pattern) in zip(AXES, self.doubt, gradients, strict=True):
            step, level = frame.diff(dim=axis), _ends(frame, axis) / 2 - self.level
            counts = _ends(self.usable[k].to(torch.uint8), axis) == 2
            yield step, level, (step - pattern - level * gain).square_().add_(doubt), counts


def likeliest_tail(squares: Tensor, scale: float) -> tuple[float, float]:
    """Degrees of freedom and squared scale of the Student distribution that makes gradients likeliest.

    `squares` are squared gradients, `scale` a squared scale to begin with.
    """
    some = squares[:: max(len(squares) // SAMPLES, 1)]
    best = (-math.inf, FREEDOMS[0], scale)
    for freedom in FREEDOMS:
        own = scale
        for _ in range(SCALE_STEPS):  # of expectation-maximisation
            own *= float(((freedom + 1) * some / (freedom * own + some)).mean())
            own = max(own, 1e-30)
        tail = torch.log1p(some / (freedom * own)).mean()
        constant = math.lgamma((freedom + 1) / 2) - math.lgamma(freedom / 2) - math.log(freedom * own) / 2
        best = max(best, (constant - (freedom + 1) / 2 * float(tail), freedom, own))
    return best[1], best[2]


def _ends(pixels: Tensor, axis: int) -> Tensor:
    """The sum of the pixels at both ends of each edge."""
    side = pixels.shape[axis] - 1
    return pixels.narrow(axis, 0, side) + pixels.narrow(axis, 1, side)


def _about(edges: Tensor, axis: int) -> Tensor:
    """The sum of the edges on both sides of each pixel: the adjoint of `_ends`."""
    return _ends(_padded(edges, axis), axis)


def _adjoint(edges: Tensor, axis: int) -> Tensor:
    """The adjoint of differences along an axis."""
    return -_padded(edges, axis).diff(dim=axis)


def _padded(edges: Tensor, axis: int) -> Tensor:
    return F.pad(edges, (1, 1) if axis == -1 else (0, 0, 1, 1))


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
        """Of the prior the pattern's deviation at the level, the gain in proportion to it, and the gain's deviation."""
        gain, offset = (float(part.sigma) if part else 0.0 for part in self.pair)
        whole = ((self.level * gain) ** 2 + offset**2) ** 0.5
        return (whole, self.level * (gain / whole) ** 2, gain * offset / whole) if whole else (0.0, 0.0, 0.0)

    def values(self, white: Tensor) -> Tensor:
        """Of gain and level, (2, h or 1, w or 1)."""
        first, second = white.view(self.shape)
        _, shared, own = self.root()
        level = self._spread(self._amplitude(first) * first)
        return torch.stack((shared * level + own * second, level))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `values`, as a map (2, h, w)."""
        gain, level = pattern.sum(self.along, keepdim=True) if self.along else pattern
        _, shared, own = self.root()
        first = self._amplitude(level) * self._gather(level + shared * gain)
        return torch.stack((first, own * gain)).flatten()

    def whiten(self, values: Tensor) -> Tensor:
        """The inverse of `values`; zero for what has no strength."""
        gain, level = values
        amplitude, (_, shared, own) = self._amplitude(level), self.root()
        first = torch.where(amplitude > 0, self._gather(level) / amplitude.clamp(min=1e-300), 0)
        return torch.stack((first, (gain - shared * level) / own if own else torch.zeros_like(gain))).flatten()

    def diagonal(self, information: Tensor) -> Tensor:
        """Of the normal matrix, from its blocks for gain and level."""
        aa, ab, bb = information
        _, shared, own = self.root()
        first = self._amplitude(bb).square() * self._edges(bb + 2 * shared * ab + shared**2 * aa)
        return 1 + torch.stack((first, own**2 * aa)).flatten()

    def _amplitude(self, like: Tensor) -> Tensor:
        """Standard deviation of each coefficient of the pattern at the level."""
        return like.new_tensor(self.root()[0])

    def _gather(self, pattern: Tensor) -> Tensor:
        """Coefficients of the pattern at the level; `_spread` is the inverse and the adjoint of it."""
        return pattern

    _spread = _gather

    def _edges(self, information: Tensor) -> Tensor:
        """What edges tell each coefficient, from what they tell each pixel of the pattern at the level."""
        return information

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
            torch.stack([getattr(part, name).double() if part else values.new_zeros(()) for part in self.pair])
            for name in ("sigma", "max_sigma")
        )
        means = self.split(values).flatten(1)
        found = estimate_sigmas(information, means, sigma, most, free)
        for i in free:
            self.pair[i].sigma.copy_(found[i].clamp(min=LOW * most[i]))  # type: ignore[union-attr]

    def split(self, values: Tensor) -> Tensor:
        """Gain and offset, from gain and level."""
        return torch.stack((values[0], values[1] - self.level * values[0]))


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

    def _amplitude(self, like: Tensor) -> Tensor:
        return super()._amplitude(like) if self.power is None else self.power.sqrt()

    def _gather(self, pattern: Tensor) -> Tensor:
        return torch.from_numpy(dctn(pattern.cpu().numpy(), norm="ortho")).to(pattern)

    def _spread(self, coefficients: Tensor) -> Tensor:
        return torch.from_numpy(idctn(coefficients.cpu().numpy(), norm="ortho")).to(coefficients)

    def _edges(self, information: Tensor) -> Tensor:
        """Each coefficient's curvature under mean weights; a pixel has four edges."""
        return float(information.mean()) / 4 * self.curvature

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
        noise = (self._gather(edges.half_difference(pattern)) * modelled).square()
        before = self._amplitude(pattern).square()
        unshrunk = (self._gather(values[1]) * (1 + modelled / before.clamp(min=1e-300))).square()
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
