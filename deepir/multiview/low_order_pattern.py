"""The low-order part of a pattern by displacements, and whether it is a sensor's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp
from scipy import ndimage

from deepir.arrays import Array
from deepir.arrays.samples import MAD_TO_SIGMA, block_means
from deepir.kernels.median_filter import median_filter
from deepir.multiview.texture_flow import RADIUS, Displacement, coarsening, displacements, enlarged, sampled

LOW_ORDER_SIGMA = 4.0  # standard deviation, px, of the Gaussian that takes the low-order part
FINE_SIDE = 5  # side, px, of the windows whose median is taken off for the fine part
#: Largest ratio of the low-order part's standard deviation to the fine part's (robust) in a sensor's pattern.
MAX_RATIO = 20.0
GAPS = (1, 2)  # frames between which displacements are sought, apart in the order of the frames
ROUNDS = 3  # times that displacements are sought, each after what was found before is taken off
#: px of the averaged frames between nodes of the grid, and between the samples that are used.
CELL, STEP = 5, 2
#: Samples that say the same: the displacement of all in a window is one, and each frame is in pairs of all gaps.
CORRELATED = len(GAPS) * ((2 * RADIUS + 1) / STEP) ** 2
DEGREE = 2  # of the polynomial
#: px of the averaged frames; Gaussian over which changes of brightness are averaged: errors of displacements at edges
#: have both signs.
CHANGE_SIGMA = 0.5
#: Share of a frame in which the displacement to its neighbour is known: at least, and in that to mirrored frames.
MIN_KNOWN, CHANCE_FACTOR = 0.02, 3.0
CHANCE_PAIRS = 5
REWEIGHTINGS = 5
MIN_SCALE = 0.003  # robust deviation of a pair's changes at least, relative to the frames' contrast
MIN_SAMPLES = 50  # samples of a pair below which it is left out


def low_order_part(pattern: Array, usable: Array) -> Array:
    """A plane and, of what it leaves of the usable pixels of a pattern (h, w), the Gaussian mean; mean zero."""
    rows, columns = np.indices(pattern.shape).astype(float) / max(pattern.shape)
    axes = np.stack((np.ones_like(rows), rows, columns), -1)
    plane = axes @ np.linalg.lstsq(axes[usable], pattern[usable], rcond=None)[0]
    share = ndimage.gaussian_filter(usable.astype(float), LOW_ORDER_SIGMA, mode="nearest")
    mean = ndimage.gaussian_filter(np.where(usable, pattern - plane, 0.0), LOW_ORDER_SIGMA, mode="nearest")
    low_order = plane + mean / np.maximum(share, 1e-9)
    return np.asarray(low_order - low_order.mean())


def is_implausible(pattern: Array, usable: Array) -> bool:
    """Whether the low-order part of a pattern (h, w) is stronger, by its fine part, than a sensor's."""
    detail = (pattern - median_filter(pattern, FINE_SIDE))[usable]
    fine = MAD_TO_SIGMA * float(np.median(np.abs(detail - np.median(detail)))) if usable.any() else 0.0
    return fine > 0 and float(low_order_part(pattern, usable)[usable].std()) > MAX_RATIO * fine


def low_order_pattern(frames: Array, usable: Array) -> Array | None:
    """The low-order additive pattern that frames still hold.

    Args:
        frames: (N, h, w), in any order in which neighbours may show the same scene; fine pattern taken off.
        usable: (N, h, w) bool, which samples count.

    Returns:
        The pattern (h, w), mean zero, in the frames' units; None where neighbouring frames do not show the same things.
    """
    factor = coarsening(frames.shape[1:])
    coarse = block_means(frames, usable, factor)
    contrast = max(float(np.median(coarse.std((1, 2)))), np.finfo(float).tiny)
    coarse /= contrast
    pairs = [(k, k + gap) for gap in GAPS for k in range(len(frames) - gap)]
    grid, total = _Grid(coarse.shape[1:]), np.zeros(coarse.shape[1:])
    for round_ in range(ROUNDS):
        found = displacements(coarse - total, pairs)
        if round_ == 0 and not _related(coarse, found):
            return None
        total += grid.fitted(coarse - total, found)
    offset = contrast * enlarged(total, frames.shape[1:], factor)
    return np.asarray(offset - offset.mean())


def _related(frames: Array, found: Sequence[Displacement]) -> bool:
    """Whether the displacements are known in far more places than those to mirrored frames, which are chance."""
    if not found:
        return False
    count = min(len(frames) - 1, CHANCE_PAIRS)
    first = np.arange(count) * (len(frames) - 1) // count
    mirrored = np.concatenate([[frames[k], frames[k + 1][:, ::-1]] for k in first])
    by_chance = displacements(mirrored, [(2 * k, 2 * k + 1) for k in range(count)])
    chance = float(np.quantile([each.share_moved for each in by_chance], 0.5))
    nearest = min(each.second - each.first for each in found)
    shares = [each.share_moved for each in found if each.second - each.first == nearest]
    return float(np.quantile(shares, 0.5)) >= max(MIN_KNOWN, CHANCE_FACTOR * chance)


class _Grid:
    """Maps (h, w) that are a polynomial and a bilinear interpolation of nodes, both of prior deviation one."""

    def __init__(self, size: tuple[int, ...]) -> None:
        self.size = size
        self.nodes = tuple(max(2, side // CELL) for side in size)
        orders = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i) if i + j]
        along = [np.polynomial.legendre.legvander(np.linspace(-1, 1, count), DEGREE) for count in self.nodes]
        self.polynomials = np.stack([np.outer(along[0][:, i], along[1][:, j]).ravel() for i, j in orders], 1)
        steps = [sp.diags([-1.0, 1.0], [0, 1], shape=(count - 1, count)) for count in self.nodes]
        down, across = (sp.kron(steps[0], sp.eye(self.nodes[1])), sp.kron(sp.eye(self.nodes[0]), steps[1]))
        smooth = down.T @ down + across.T @ across + 1e-6 * sp.eye(len(self.polynomials))
        self.prior = sp.block_diag([smooth, sp.eye(len(orders))]).tocsr()

    def fitted(self, frames: Array, found: Sequence[Displacement]) -> Array:
        """The map that explains best how brightness changes along the displacements; Cauchy weights."""
        equations = [each for each in (self._equations(frames, one) for one in found) if each is not None]
        unknowns = np.zeros(self.prior.shape[0])
        for _ in range(REWEIGHTINGS):
            normal, score, levels = self.prior.toarray(), np.zeros_like(unknowns), []
            for design, change in equations:
                rest = change - design @ unknowns
                rest -= np.median(rest)
                scale = max(MAD_TO_SIGMA * float(np.median(np.abs(rest))), MIN_SCALE)
                weight = 1 / (scale**2 + rest**2) / CORRELATED
                weighted = design.T.multiply(weight).tocsr()
                # Each pair has a level of its own: it is eliminated.
                sums, total = weighted @ np.ones(len(weight)), weight.sum()
                normal += (weighted @ design).toarray()
                score += weighted @ change - sums * (weight @ change) / total
                levels.append(sums / total**0.5)
            normal -= np.transpose(levels) @ np.array(levels)
            unknowns = np.linalg.solve(normal, score)
        nodes = unknowns[: len(self.polynomials)] + self.polynomials @ unknowns[len(self.polynomials) :]
        return np.asarray(self._weights(*np.mgrid[: self.size[0], : self.size[1]].astype(float)) @ nodes).reshape(
            self.size
        )

    def _equations(self, frames: Array, found: Displacement) -> tuple[sp.csr_matrix, Array] | None:
        """L(p) - L(p + v) of the unknowns, and the change of brightness, at some of the known samples."""
        some = np.zeros(self.size, bool)
        some[::STEP, ::STEP] = True
        some &= found.known
        if some.sum() < MIN_SAMPLES:
            return None
        rows, columns = np.nonzero(some)
        y, x = found.y[some], found.x[some]
        change = _change(frames, found)[some]
        nodes = self._weights(rows.astype(float), columns.astype(float)) - self._weights(y, x)
        return sp.hstack([nodes, nodes @ self.polynomials]).tocsr(), change

    def _weights(self, y: Array, x: Array) -> sp.csr_matrix:
        """Bilinear weights of the nodes at points, (points, nodes)."""
        low, part = [], []
        for at, side, count in zip((y.ravel(), x.ravel()), self.size, self.nodes, strict=True):
            place = np.clip((at + 0.5) * count / side - 0.5, 0, count - 1)
            low.append(np.minimum(place.astype(int), count - 2))
            part.append(place - low[-1])
        corners = [(i, j) for i in (0, 1) for j in (0, 1)]
        weights = [np.abs(1 - i - part[0]) * np.abs(1 - j - part[1]) for i, j in corners]
        indices = [(low[0] + i) * self.nodes[1] + low[1] + j for i, j in corners]
        points = np.tile(np.arange(len(low[0])), 4)
        shape = (len(low[0]), len(self.polynomials))
        return sp.csr_matrix((np.concatenate(weights), (points, np.concatenate(indices))), shape=shape)


def _change(frames: Array, found: Displacement) -> Array:
    """What brightness changes along a displacement, averaged over the known samples nearby, (h, w)."""
    change = frames[found.first] - sampled(frames[found.second], found.y, found.x)
    known = ndimage.gaussian_filter(found.known.astype(float), CHANGE_SIGMA)
    change = ndimage.gaussian_filter(np.where(found.known, change, 0.0), CHANGE_SIGMA)
    return np.asarray(change / np.maximum(known, np.finfo(float).tiny))
