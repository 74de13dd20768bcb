"""The sensor's pattern from frames of different scenes, of which none can be registered to another.

`deepir.edges` has what the frames say of it; the parts of gain and offset are Gaussian, their strengths the likeliest.
Slow slopes are common to many scenes (the sky is above): a polynomial that all frames share is taken to be theirs,
unless the offset has a `shading`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.edges import Edges
from deepir.elimination import COLUMN, PIXEL, ROW
from deepir.evidence import likeliest
from deepir.priors.parts import Part
from deepir.priors.shading import Shading
from deepir.strengths import MOST, share, spread

FIRST, ROUNDS = 3, 12  # of reweighting: those with the strengths as they start, and all
DEGREE = 8  # of the polynomial that scenes share
LOW = 0.05  # least strength, in the most: what falls to nothing does not come back
GAIN = 0.02  # what parts of the gain start with
STEPS, PRECISE = 500, 1e-8  # of conjugate gradients, and the square of their error


@torch.no_grad()
def find_pattern(
    frames: Tensor, usable: Tensor, gain: Sequence[Part], offset: Sequence[Part]
) -> tuple[Edges, Tensor]:
    """Set the parts of gain and offset, with their strengths where those are not given.

    Args:
        frames: (N, h, w), each of a scene of its own.
        usable: which samples count, bool, same shape.
        gain: parts of the gain, at most one each of columns, rows, pixels; none for a known gain.
        offset: parts of the offset, and perhaps a shading.

    Returns:
        The edges, and all that the frames were found to share, of gain and level, (2, h, w).
    """
    edges = Edges(frames, usable)
    unknowns = _Unknowns(edges, gain, offset)
    for i in range(ROUNDS):
        unknowns.solve(edges)
        if i == FIRST:
            unknowns.bound()
        if i >= FIRST:
            unknowns.update_strengths(edges)
        edges.weigh(unknowns.pattern(unknowns.white))
    unknowns.solve(edges)
    return edges, unknowns.finish()


class _Parts:
    """Gain and offset of the pixels, the columns or the rows, in white coordinates.

    The first is what the pattern at the frames' level has of them, the second what then is open of the gain: with
    a pedestal of 8,000 counts gain and offset themselves are next to the same.
    """

    def __init__(
        self, along: tuple[int, ...], pair: list[Part | None], level: float, size: Sequence[int]
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

    def bound(self, level: Tensor) -> None:
        """Let no strength explain more than twice the pattern (h, w) at the frames' level.

        Gain and offset would else grow, and cancel each other there, where scenes are alike.
        """
        for part, unit in zip(self.pair, (abs(self.level), 1.0), strict=True):
            if part:
                part.most.fill_(MOST * spread(share(level, part)) / max(unit, 1e-30))

    def update_strengths(self, information: Tensor, values: Tensor) -> None:
        """The likeliest, all other parts held."""
        aa, ab, bb = information.flatten(1)
        level = self.level
        information = torch.stack((aa + 2 * level * ab + level**2 * bb, ab + level * bb, bb))
        free = [i for i, part in enumerate(self.pair) if part and not part.given]
        sigma, most = (
            torch.stack(
                [getattr(part, name).double() if part else values.new_zeros(()) for part in self.pair]
            )
            for name in ("sigma", "most")
        )
        means = self.split(values).flatten(1)
        found = likeliest(information, means, sigma, most, free)
        for i in free:
            self.pair[i].sigma.copy_(found[i].clamp(min=LOW * most[i]))  # type: ignore[union-attr]

    def split(self, values: Tensor) -> Tensor:
        """Gain and offset, from gain and level."""
        return torch.stack((values[0], values[1] - self.level * values[0]))


class _Unknowns:
    """All parts in white coordinates, and a polynomial as free as the frames vary: that of the scenes, or a shading."""

    def __init__(self, edges: Edges, gain: Sequence[Part], offset: Sequence[Part]) -> None:
        self.level, (height, width) = edges.level, edges.frames.shape[1:]
        typical = float(edges.scales.median().sqrt())
        self.parts = []
        for along in (PIXEL, COLUMN, ROW):
            pair = [next((part for part in parts if part.along == along and not isinstance(part, Shading)), None)
                for parts in (gain, offset)]  # fmt: skip
            for part, start in zip(pair, (GAIN, typical), strict=True):
                if part and not part.given:
                    part.sigma.fill_(start)
            if any(pair):
                self.parts.append(_Parts(along, pair, edges.level, (height, width)))
        self.shading = next((part for part in offset if isinstance(part, Shading)), None)
        self.slow = self.shading or Shading((1, 1, height, width), degree=DEGREE).to(edges.frames.device)
        free = edges.scales.new_tensor([[1.0], [float(edges.frames.std())]])  # of gain and level
        self.steep = free / (self.slow.of_y + self.slow.of_x).square()
        self.sizes = [math.prod(parts.shape) for parts in self.parts]
        self.white = edges.scales.new_zeros(sum(self.sizes) + self.steep.numel())

    def split(self, white: Tensor) -> tuple[list[Tensor], Tensor]:
        """The values of the parts, and the terms of the polynomial."""
        *each, slow = white.split([*self.sizes, self.steep.numel()])
        return [
            parts.values(mine) for parts, mine in zip(self.parts, each, strict=True)
        ], self.steep * slow.view_as(self.steep)

    def pattern(self, white: Tensor) -> Tensor:
        """All that the frames share, of gain and level, (2, h, w)."""
        values, terms = self.split(white)
        return sum(values, self.slow.spread(terms))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `pattern`."""
        return torch.cat(
            [
                *(parts.adjoint(pattern) for parts in self.parts),
                (self.steep * self.slow.sums(pattern)).flatten(),
            ]
        )

    def solve(self, edges: Edges) -> None:
        """The optimum for the edges' weights, by conjugate gradients from where it is."""
        known = [parts.diagonal(edges.information(parts.along)) for parts in self.parts]
        scale, smooth = 1 / torch.cat(known), self._smooth(edges)

        def near(x: Tensor) -> Tensor:
            return torch.cat((scale * x[: len(scale)], smooth @ x[len(scale) :]))

        rhs = self.adjoint(edges.score())
        rest = rhs - self._normal(self.white, edges)
        way = near(rest)
        square, least = rest @ way, PRECISE * (rhs @ near(rhs))
        for _ in range(STEPS):
            if square <= least:
                return
            image = self._normal(way, edges)
            step = square / (way @ image)
            self.white += step * way
            rest -= step * image
            better = near(rest)
            before, square = square, rest @ better
            way = better + square / before * way

    def _smooth(self, edges: Edges) -> Tensor:
        """The inverse of the polynomials' block of the normal matrix, if all edges along an axis weighed the same."""
        y, x, order_y, order_x = self.slow.in_y, self.slow.in_x, self.slow.of_y, self.slow.of_x
        steep = self.steep.flatten()
        block = torch.zeros(len(steep), len(steep)).to(steep)
        for sums, down, across in zip(edges.sums, (y, y.diff()), (x.diff(), x), strict=True):
            of_y, of_x = down @ down.T, across @ across.T
            aa, ab, bb = sums[:3].mean((1, 2)).tolist()
            weights = steep.new_tensor([[aa, ab], [ab, bb]])
            block += torch.kron(weights, of_y[order_y][:, order_y] * of_x[order_x][:, order_x])
        block = steep[:, None] * block * steep
        block.diagonal().add_(1)
        return torch.linalg.inv(block)

    def _normal(self, white: Tensor, edges: Edges) -> Tensor:
        return white + self.adjoint(edges.normal(self.pattern(white)))

    def bound(self) -> None:
        """Bound all strengths by what the pattern is now."""
        _, level = self.pattern(self.white)
        for parts in self.parts:
            parts.bound(level)

    def update_strengths(self, edges: Edges) -> None:
        """Strengths that are not given anew; the values stay."""
        values, _ = self.split(self.white)
        each = self.white.split([*self.sizes, self.steep.numel()])
        for parts, mine, white in zip(self.parts, values, each, strict=False):
            parts.update_strengths(edges.information(parts.along), mine)
            white.copy_(parts.whiten(mine))

    def finish(self) -> Tensor:
        """Set the parts; all that the frames share, of gain and level, (2, h, w)."""
        values, terms = self.split(self.white)
        for parts, mine in zip(self.parts, values, strict=True):
            for part, value in zip(parts.pair, parts.split(mine), strict=True):
                if part:
                    part.assign(value.reshape(part.white.shape))
        if self.shading is not None:
            if not self.shading.given:
                self.shading.sigma.copy_(terms[1].square().mean().sqrt())
            self.shading.assign(terms[1])
        return self.pattern(self.white)
