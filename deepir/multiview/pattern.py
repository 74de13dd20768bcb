"""The pattern that frames of different scenes share."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from deepir.arrays import Array
from deepir.arrays.samples import block_means, pattern_outliers
from deepir.closed_form.conjugate_gradient import conjugate_gradient
from deepir.closed_form.variable_projection import COLUMN, PIXEL, ROW
from deepir.fields.sensor_maps import Column, GaussianMap, Pixel, Row
from deepir.fields.shading import Shading
from deepir.multiview.gradients import ColouredPixels, Edges, WhiteParts
from deepir.multiview.low_order_pattern import is_implausible, low_order_part, low_order_pattern
from deepir.multiview.pattern_gradients import gradient_consensus, shares
from deepir.multiview.texture_flow import TEXTURE_SIGMA, coarsening, displacements

PAIRS = 5  # pairs of frames, half the recording apart, that are compared
DETAIL = 5  # px, of the box average that is taken off for the fine part of what all frames share
#: Deviation of the coarser texture that all frames share, in that of its fine part, from which it may be a scene's:
#: white pixels have 0.2, a raw pattern that hides the scene 0.3 to 0.7, a camera at rest behind a shutter 2.
SCENE_RATIO = 1.0
#: Share of the frame that two frames of a camera at rest both show, at least, and upper quartile of its displacements,
#: px, at most.
SHARED, REST = 0.5, 1.0
#: Root mean square of (f_k - 1) in its standard errors, and by itself, from which frames have gains of their own.
SIGNIFICANCE, MIN_SPREAD = 4.0, 0.05
FIRST, ROUNDS = 3, 12  # of reweighting: those with the strengths as they start, and all
DEGREE = 8  # of the polynomial that scenes share
GAIN = 0.02  # what parts of the gain start with
#: Variance of the scenes' mean slopes, in that between the scenes: 0 if they point anywhere, 1 and more under one sky.
MEAN_SHARE = 0.5
PRECISE, STEPS = 1e-4, 30  # of the optimum for given weights, from that for those before


def is_at_rest(frames: Array, usable: Array) -> bool:
    """Whether frames (N, h, w) show the same scene at the same place, whatever moves through it."""
    shared = gradient_consensus(frames, usable)
    coarse = ndimage.uniform_filter(shared, DETAIL)
    detail, texture = shared - coarse, coarse - ndimage.gaussian_filter(shared, TEXTURE_SIGMA)
    if np.median(np.abs(texture)) < SCENE_RATIO * np.median(np.abs(detail)):
        return False
    factor, half = coarsening(frames.shape[1:]), len(frames) // 2
    blocks = block_means(frames - detail, usable, factor)
    first = np.unique(np.linspace(0, len(frames) - half - 1, PAIRS).round().astype(int))
    shares, quartiles = [], []
    for found in displacements(blocks, [(k, k + half) for k in first]):
        moved = np.hypot(*found.vectors)[found.known]
        shares.append(found.known.mean())
        quartiles.append(np.quantile(moved, 0.75) * factor if moved.size else np.inf)
    return bool(np.median(shares) >= SHARED and np.median(quartiles) <= REST)


def frame_gains(frames: Tensor, usable: Tensor, pattern: Tensor) -> Tensor | None:
    """Gains (N,) of frames (N, h, w), of geometric mean one; None where they are not clearly different.

    Args:
        frames: in any units.
        usable: which samples count, same shape.
        pattern: what they share, (h, w).
    """
    parts, masked = pattern.numpy()[None], torch.where(usable, frames, torch.nan).numpy()
    gains, errors = np.squeeze([shares(each[None], parts, np.ones_like(parts[0], bool)) for each in masked], 2).T
    if not (gains > SIGNIFICANCE * errors).all():
        return None
    gains = gains / np.exp(np.log(gains).mean())
    apart = gains - np.median(gains)
    clear = np.mean((apart / errors) ** 2) > SIGNIFICANCE**2 and np.mean(apart**2) > MIN_SPREAD**2
    return torch.from_numpy(gains).to(frames) if clear else None


@torch.no_grad()
def find_pattern(
    frames: Tensor, usable: Tensor, gain: Sequence[GaussianMap], offset: Sequence[GaussianMap]
) -> tuple[Edges, Tensor, Shading]:
    """Set the parts of gain and offset, with their strengths where those are not given.

    Args:
        frames: (N, h, w), each of a scene of its own.
        usable: which samples count, bool, same shape.
        gain: parts of the gain, at most one each of columns, rows, pixels; none for a known gain.
        offset: parts of the offset, and perhaps a shading.

    Returns:
        The edges; all that the frames were found to share, of gain and level, (2, h, w); and the low-order part of the
        level, which is in no part unless a shading's strength is given.
    """
    shared = gradient_consensus(frames.numpy(), usable.numpy())
    # A Gaussian prior, whatever its spectrum, would take most of the offsets of single pixels away.
    outliers = pattern_outliers(shared, usable.any(0).numpy())
    isolated = torch.from_numpy(np.where(outliers, shared - ndimage.median_filter(shared, 3), 0))
    edges = Edges(frames - isolated, usable, torch.from_numpy(shared) - isolated)
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
    pattern = unknowns.finish()
    pattern[1] += isolated
    for part in offset:
        if part.constant_axes == PIXEL and not isinstance(part, Shading):
            part.assign(part.values + isolated)
    return edges, pattern, unknowns.low_order


def estimate_offset(frames: np.ndarray, usable: np.ndarray) -> tuple[np.ndarray, bool]:
    """The offset (h, w), mean zero, that frames (N, h, w) share, found without registration; no gain.

    Also, whether neighbouring frames show the same things displaced; these then give the low-order part of the offset.
    A low-order part that is implausibly strong for a sensor is left out.
    """
    maps = (1, 1, *frames.shape[1:])
    data, good = torch.from_numpy(frames), torch.from_numpy(usable)
    _, pattern, low_order = find_pattern(data, good, (), (Column(maps), Row(maps), Pixel(maps)))
    offset = pattern[1].numpy()
    moved = low_order_pattern(frames - offset, usable)
    if moved is not None:
        offset = offset + moved
    else:
        shared = low_order.values[0, 0].detach().numpy()
        shrink_shading(low_order, data - pattern[1])
        offset = offset - shared + low_order.values[0, 0].detach().numpy()
    known = np.asarray(usable.any(0))
    if is_implausible(offset, known):
        offset = offset - low_order_part(offset, known)
    return offset - offset[known].mean(), moved is not None


@torch.no_grad()
def shrink_shading(shading: Shading, corrected: Tensor) -> float:
    """Leave of a shading that all frames share what is likelier the sensor's than the scenes'; the share of it.

    Scenes differ from each other about as much as their mean differs from a plain one. So the polynomials' terms of
    each degree are the sum of a Gaussian share of the scenes, of `MEAN_SHARE` times the variance between them, and one
    of the sensor, of the variance that is then left (empirical Bayes).

    `corrected` are the frames (N, h, w) without the pattern.
    """
    terms = shading.prior_sigma * shading.whitened
    area = corrected.shape[-2] * corrected.shape[-1]
    between = (shading.analyse(corrected.to(terms)) / area).var(0) * MEAN_SHARE
    degree, kept = shading.order_y + shading.order_x, torch.zeros_like(terms)
    for each in degree.unique():
        some = degree == each
        whole, scenes = terms[some].square().mean(), between[some].mean()
        kept[some] = ((whole - scenes) / whole.clamp(min=1e-300)).clamp(min=0)
    shading.assign(shading.synthesise(kept * terms)[None, None])
    return float((kept * terms).norm() / terms.norm().clamp(min=1e-300))


class _Unknowns:
    """All parts in white coordinates, and polynomials as free as the frames vary: the scenes', or a shading."""

    def __init__(self, edges: Edges, gain: Sequence[GaussianMap], offset: Sequence[GaussianMap]) -> None:
        self.level, (height, width) = edges.level, edges.frames.shape[1:]
        typical = edges.typical
        self.parts = []
        for along in (PIXEL, COLUMN, ROW):
            pair = [
                next((p for p in parts if p.constant_axes == along and not isinstance(p, Shading)), None)
                for parts in (gain, offset)
            ]
            for part, start in zip(pair, (GAIN, typical), strict=True):
                if part and not part.sigma_is_fixed:
                    part.sigma.fill_(start)
            if any(pair):
                kind = WhiteParts if along else ColouredPixels
                self.parts.append(kind(along, pair, edges.level, (height, width)))
        given = [part for part in offset if isinstance(part, Shading) and part.sigma_is_fixed]
        free = Shading((1, 1, height, width), degree=DEGREE).to(edges.frames.device)
        self.low_order = given[0] if given else free
        deviation = float(edges.frames.flatten(1).std(1).median())
        self.unit = math.hypot(edges.level, deviation)  # counts that a gain of one is about
        free_by = edges.scales.new_tensor([[1.0 if gain else 0.0], [deviation]])  # of gain and level
        self.steep = free_by / (self.low_order.order_y + self.low_order.order_x).square()
        self.sizes = [math.prod(parts.shape) for parts in self.parts]
        self.white = edges.scales.new_zeros(sum(self.sizes) + self.steep.numel())

    def split(self, white: Tensor) -> tuple[list[Tensor], Tensor]:
        """The values of the parts, and the terms of the polynomial."""
        *each, low_order = white.split([*self.sizes, self.steep.numel()])
        values = [parts.values(mine) for parts, mine in zip(self.parts, each, strict=True)]
        return values, self.steep * low_order.view_as(self.steep)

    def pattern(self, white: Tensor) -> Tensor:
        """All that the frames share, of gain and level, (2, h, w)."""
        values, terms = self.split(white)
        return sum(values, self.low_order.synthesise(terms))

    def adjoint(self, pattern: Tensor) -> Tensor:
        """The adjoint of `pattern`."""
        low_order = (self.steep * self.low_order.analyse(pattern)).flatten()
        return torch.cat([*(parts.adjoint(pattern) for parts in self.parts), low_order])

    def solve(self, edges: Edges) -> None:
        """The optimum for the edges' weights, by conjugate gradients from where it is."""
        known = [parts.diagonal(edges.information(parts.along)) for parts in self.parts]
        scale, smooth = 1 / torch.cat(known), self._smooth(edges)

        def near(x: Tensor) -> Tensor:
            return torch.cat((scale * x[: len(scale)], smooth @ x[len(scale) :]))

        self.white = conjugate_gradient(
            lambda white: white + self.adjoint(edges.normal(self.pattern(white))),
            self.adjoint(edges.score()),
            self.white,
            precondition=near,
            tolerance=PRECISE,
            max_iterations=STEPS,
        )

    def _smooth(self, edges: Edges) -> Tensor:
        """The inverse of the polynomials' block of the normal matrix, if all edges along an axis weighed the same."""
        y, x = self.low_order.basis_y, self.low_order.basis_x
        order_y, order_x = self.low_order.order_y, self.low_order.order_x
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
        pattern = self.pattern(self.white)
        each = self.white.split([*self.sizes, self.steep.numel()])
        for parts, mine, white in zip(self.parts, values, each, strict=False):
            parts.update_strengths(edges, pattern, mine)
            white.copy_(parts.whiten(mine))

    def finish(self) -> Tensor:
        """Set the parts; all that the frames share, of gain and level, (2, h, w)."""
        values, terms = self.split(self.white)
        for parts, mine in zip(self.parts, values, strict=True):
            for part, value in zip(parts.pair, parts.split(mine), strict=True):
                if part:
                    part.assign(value.reshape(part.whitened.shape))
        if not self.low_order.sigma_is_fixed:
            self.low_order.sigma.copy_(terms[1].square().mean().sqrt())
        self.low_order.assign(self.low_order.synthesise(terms[1])[None, None])
        return self.pattern(self.white)
