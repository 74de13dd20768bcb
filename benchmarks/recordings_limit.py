"""Cramér-Rao limit of the low-order part of an offset, for hand-held recordings, whose paths are known.

Map-making: `y_k(p) = scene(point) + offset(p) + level_k + noise`. The brightness of each point is unknown and
eliminated along its track, and so are the levels of the frames. The offset is bilinear between cells, each free.
Noise is white, and displacements are known: estimates that have to find them leave more.

Source: D. J. Fixsen, S. H. Moseley, R. G. Arendt: Calibrating array detectors, ApJS 128 (2000).
"""

from __future__ import annotations

import types
from typing import Any

import numpy as np
from recordings_scores import LOW_ORDER
from scipy import ndimage, sparse

Array = np.ndarray

CELL = 8  # px, side of a cell
SPACING = 4  # px between points of the scene


def low_order_limit(drawn: types.ModuleType, arguments: tuple[Any, ...]) -> float:
    """Least error of the low-order part over the part itself.

    Args:
        drawn: The module that draws the recordings.
        arguments: With which it draws a hand-held one.
    """
    folder, seed, count, size, reach, kind, span, low, _, noise, *_ = arguments
    shifts, turns = _path(drawn, folder, seed, count, size, reach, kind)
    found = information(shifts, turns, size) * (SPACING / noise) ** 2
    covariance = np.linalg.inv(found + np.eye(len(found)) / (low * span) ** 2)
    cells = size[0] // CELL, size[1] // CELL
    smooth = np.eye(len(found)).reshape(-1, *cells)
    smooth = ndimage.gaussian_filter(smooth, (0, *(2 * [LOW_ORDER / CELL]))).reshape(len(found), -1)
    covariance = smooth.T @ covariance @ smooth
    variance = np.trace(covariance) / len(found) - covariance.mean()  # of all but the level
    return float(np.sqrt(variance) / (low * span))


def _path(
    drawn: types.ModuleType, folder: str, seed: int, count: int, size: tuple[int, int], reach: int, kind: str
) -> tuple[Array, Array]:
    """Shifts (N, 2), y and x in px, and turns (N,), rad, as the recording draws them."""
    rng, pictures = np.random.default_rng(seed), drawn.pictures(folder)
    picture = np.array(pictures[int(rng.integers(len(pictures)))].shape) // 2
    most = min((picture - size) / 2) - 4
    shifts = np.clip(drawn.path(rng, count, reach, kind), -most, most)
    turns = rng.normal(0, 0.002, count).cumsum()
    return shifts, turns - turns.mean()


def information(shifts: Array, turns: Array, size: tuple[int, int]) -> Array:
    """Information on the cells of the offset, (cells, cells), of noise of variance one at each point and frame."""
    cells = tuple(side // CELL for side in size)
    reach = np.array(size) / 2 + np.abs(shifts).max(0) + SPACING
    y, x = (each.ravel() for each in np.mgrid[-reach[0] : reach[0] : SPACING, -reach[1] : reach[1] : SPACING])
    offsets, points, frames = [], [], []
    for k, ((dy, dx), turn) in enumerate(zip(shifts, turns, strict=True)):
        row = np.cos(turn) * (y - dy) + np.sin(turn) * (x - dx) + size[0] / 2
        column = np.cos(turn) * (x - dx) - np.sin(turn) * (y - dy) + size[1] / 2
        seen = (row > 0) & (row < size[0]) & (column > 0) & (column < size[1])
        offsets.append(_bilinear(row[seen] / CELL - 0.5, column[seen] / CELL - 0.5, cells))
        points.append(np.flatnonzero(seen))
        frames.append(np.full(seen.sum(), k))
    levels = _indicators(np.concatenate(frames), len(shifts))
    unknowns = sparse.hstack([sparse.vstack(offsets), levels]).tocsr()
    tracks = _indicators(np.concatenate(points), len(y))
    along, length = (tracks.T @ unknowns).tocsr(), np.asarray(tracks.sum(0)).ravel()
    weights = sparse.diags(1 / np.maximum(length, 1))
    whole = (unknowns.T @ unknowns - along.T @ weights @ along).toarray()
    count = cells[0] * cells[1]
    of_levels = whole[count:, count:] + 1e-9 * np.eye(len(shifts))  # their common level is free
    return whole[:count, :count] - whole[:count, count:] @ np.linalg.solve(of_levels, whole[count:, :count])


def _indicators(numbers: Array, count: int) -> sparse.csr_matrix:
    ones = np.ones(len(numbers))
    return sparse.csr_matrix((ones, (np.arange(len(numbers)), numbers)), (len(numbers), count))


def _bilinear(row: Array, column: Array, cells: tuple[int, ...]) -> sparse.csr_matrix:
    """Weights of the cells (places, cells) at places in units of cells."""
    row, column = (np.clip(at, 0, n - 1.001) for at, n in zip((row, column), cells, strict=True))
    top, left = row.astype(int), column.astype(int)
    below, right = row - top, column - left
    number = top * cells[1] + left
    columns = np.stack([number, number + 1, number + cells[1], number + cells[1] + 1], 1)
    weights = np.stack([(1 - below) * (1 - right), (1 - below) * right, below * (1 - right), below * right], 1)
    rows = np.repeat(np.arange(len(row)), 4)
    return sparse.csr_matrix((weights.ravel(), (rows, columns.ravel())), (len(row), cells[0] * cells[1]))
