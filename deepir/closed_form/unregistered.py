"""The sensor's pattern from frames of different scenes, of which none can be registered to another.

`deepir.closed_form.edges` has what the frames say of it; the parts of gain and offset are Gaussian, their strengths the
likeliest. Slow slopes are common to many scenes (the sky is above): a polynomial that all frames share is taken to be
theirs, unless the offset has a `shading`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from deepir.closed_form.conjugate_gradients import conjugate_gradients
from deepir.closed_form.edges import Edges
from deepir.closed_form.elimination import COLUMN, PIXEL, ROW
from deepir.closed_form.white_parts import WhiteParts
from deepir.priors.parts import Part
from deepir.priors.shading import Shading

FIRST, ROUNDS = 3, 12  # of reweighting: those with the strengths as they start, and all
DEGREE = 8  # of the polynomial that scenes share
GAIN = 0.02  # what parts of the gain start with
PRECISE, STEPS = 1e-4, 30  # of the optimum for given weights, from that for those before


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
        pattern = unknowns.pattern(unknowns.white)
        if i == FIRST:
            for parts in unknowns.parts:
                parts.bound(pattern[1], unknowns.unit)
        if i >= FIRST:
            unknowns.update_strengths(edges)
        edges.weigh(pattern)
    unknowns.solve(edges)
    return edges, unknowns.finish()


class _Unknowns:
    """All parts in white coordinates, and polynomials as free as the frames vary: the scenes', or a shading."""

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
                self.parts.append(WhiteParts(along, pair, edges.level, (height, width)))
        self.shading = next((part for part in offset if isinstance(part, Shading)), None)
        self.slow = self.shading or Shading((1, 1, height, width), degree=DEGREE).to(edges.frames.device)
        deviation = float(edges.frames.std())
        self.unit = math.hypot(edges.level, deviation)  # counts that a gain of one is about
        free = edges.scales.new_tensor([[1.0], [deviation]])  # of gain and level
        self.steep = free / (self.slow.of_y + self.slow.of_x).square()
        self.sizes = [math.prod(parts.shape) for parts in self.parts]
        self.white = edges.scales.new_zeros(sum(self.sizes) + self.steep.numel())

    def split(self, white: Tensor) -> tuple[list[Tensor], Tensor]:
        """The values of the parts, and the terms of the polynomial."""
        *each, slow = white.split([*self.sizes, self.steep.numel()])
        values = [parts.values(mine) for parts, mine in zip(self.parts, each, strict=True)]
        return values, self.steep * slow.view_as(self.steep)

    def pattern(self, white: Tensor) -> Tensor:
        """All that the frames share, of gain and level, (2, h, w)."""
        values, terms = self.split(white)
        return sum(values, self.slow.spread(terms))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `pattern`."""
        slow = (self.steep * self.slow.sums(pattern)).flatten()
        return torch.cat([*(parts.adjoint(pattern) for parts in self.parts), slow])

    def solve(self, edges: Edges) -> None:
        """The optimum for the edges' weights, by conjugate gradients from where it is."""
        known = [parts.diagonal(edges.information(parts.along)) for parts in self.parts]
        scale, smooth = 1 / torch.cat(known), self._smooth(edges)

        def near(x: Tensor) -> Tensor:
            return torch.cat((scale * x[: len(scale)], smooth @ x[len(scale) :]))

        self.white = conjugate_gradients(
            lambda white: white + self.adjoint(edges.normal(self.pattern(white))),
            self.adjoint(edges.score()),
            self.white,
            near=near,
            precise=PRECISE,
            steps=STEPS,
        )

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
            self.shading.assign(self.shading.spread(terms[1])[None, None])
        return self.pattern(self.white)
