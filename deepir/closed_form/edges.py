"""What frames of different scenes say of the sensor's pattern, at the edges between neighbouring pixels.

Most gradients of a picture are next to nothing and a few are large: about Cauchy distributed, on a scale of each
picture's own. A pattern adds the same gradient to all frames, and one of the gain a gradient in proportion to the flux.
So at an edge of frame k, at the level z_k,

    ∇y_k = ∇o + z_k ∇g + a Cauchy number on the scale s_k.

The likeliest pattern is found by reweighted least squares (Holland and Welsch 1977): the flatter a frame is at an edge,
the more it counts there. The weights add up over the frames, so that what is to be solved has the size of one.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor

SHARE = 0.25  # what a gradient counts: its neighbours say much the same
LEAST = 1e-6  # of a frame's squared scale, in that of the typical frame
AXES = (-1, -2)


class Edges:
    """Sums over frames (N, h, w) at their edges along x and along y; `usable`, of the same shape, says which count.

    A pattern is (2, h, w): of the gain, and of the frames' mean `level`, `offset + level * gain`. The data say the
    latter well even where they do not tell gain from offset.
    """

    def __init__(self, frames: Tensor, usable: Tensor) -> None:
        self.frames, self.usable = frames, usable
        self.level = float(frames[usable].mean(dtype=torch.float64))
        nothing = torch.zeros(2, *frames.shape[1:], dtype=torch.float64, device=frames.device)
        #: Variance of the pattern's gradients as it is found: where it follows a frame, the frame leaves no residual.
        self.doubt = [nothing[0].diff(dim=axis) for axis in AXES]
        #: Squared scale of each frame's gradients.
        self.scales = torch.stack([
            torch.cat([squares[counts] for *_, squares, counts in self._seen(k, nothing)]).median()
            for k in range(len(frames))
        ])  # fmt: skip
        self.weigh(nothing)

    def weigh(self, pattern: Tensor) -> None:
        """Weigh each gradient by what the pattern leaves of it."""
        self.scales.clamp_(min=max(LEAST * float(self.scales.median()), 1e-30))
        #: For each axis the normal matrix (aa, ab, bb) of the gradients of gain (a) and level's pattern (b), and the
        #: right-hand side (a, b).
        self.sums = [pattern.new_zeros(5, *pattern[0].diff(dim=axis).shape) for axis in AXES]
        for k in range(len(self.frames)):
            seen = list(self._seen(k, pattern))
            squares = torch.cat([each[counts] for *_, each, counts in seen])
            # A step of expectation-maximisation to the likeliest scale.
            self.scales[k] *= (2 * squares / (self.scales[k] + squares)).mean()
            for sums, (step, level, square, counts) in zip(self.sums, seen, strict=True):
                weight = 2 * SHARE * counts / (self.scales[k] + square)
                of_gain = weight * level
                terms = of_gain * level, of_gain, weight, of_gain * step, weight * step
                for i, term in enumerate(terms):
                    sums[i] += term
        known = torch.stack([_about(sums[2], axis) for axis, sums in zip(AXES, self.sums, strict=True)]).sum(
            0
        )
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
        return torch.stack(
            [_adjoint(sums[3:], axis) for axis, sums in zip(AXES, self.sums, strict=True)]
        ).sum(0)

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
        for k in range(len(self.frames)):
            for i, (_, _, square, counts) in enumerate(self._seen(k, pattern)):
                sums[i] += counts * (square / self.scales[k]).log1p()
        each = []
        for axis, total in zip(AXES, sums, strict=True):
            side, outermost = total.shape[axis], [total.narrow(axis, i, 1) for i in (0, -1)]
            padded = torch.cat((outermost[0], total, outermost[1]), axis)
            each += [padded.narrow(axis, i, side + 1) for i in (0, 1)]
        return torch.stack(each).sort(0).values[1] / len(self.frames)

    def _seen(self, k: int, pattern: Tensor) -> Iterator[tuple[Tensor, Tensor, Tensor, Tensor]]:
        """Along each axis frame k's gradients, levels, squares of what the pattern leaves of them, and which count."""
        frame = self.frames[k].double()
        for axis, doubt in zip(AXES, self.doubt, strict=True):
            step, level = frame.diff(dim=axis), _ends(frame, axis) / 2 - self.level
            counts = _ends(self.usable[k].to(torch.uint8), axis) == 2
            gain, pattern_ = pattern.diff(dim=axis)
            yield step, level, (step - pattern_ - level * gain).square_().add_(doubt), counts


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
