# mypy: disable-error-code="no-untyped-def"
"""Medians of windows of a picture."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from deepir.kernels.compile import compiled, parallel_for

Array = np.ndarray[Any, Any]

MIN_PARALLEL_PIXELS = 100_000  # of a picture, from which a second thread is faster


def median_filter(picture: Array, side: int) -> Array:
    """The median of the `side` x `side` px around each pixel, side odd; mirrored at the border.

    Args:
        picture: (h, w), floating point, without NaN.
        side: odd number, px.
    """
    padded = np.pad(picture, side // 2, mode="symmetric")
    found = np.empty_like(picture, order="C")
    if picture.size < MIN_PARALLEL_PIXELS:
        window_medians(0, len(found), padded, side, comparators(side * side), found)
    else:
        parallel_for(window_medians, len(found), padded, side, comparators(side * side), found)
    return found


@functools.cache
def comparators(count: int) -> Array:
    """Pairs (K, 2) of places to compare and exchange, after which the middle one of `count` has the median.

    Batcher's network of merges, without what does not reach the middle. Source: Knuth, "The Art of Computer
    Programming" 3, 5.2.2, algorithm M.
    """
    network: list[tuple[int, int]] = []
    top = 1 << ((count - 1).bit_length() - 1) if count > 1 else 0
    step = top
    while step:
        apart, low, rest = top, 0, step
        while True:
            network += [(i, i + rest) for i in range(count - rest) if i & step == low]
            if apart == step:
                break
            rest, low, apart = apart - step, step, apart // 2
        step //= 2
    needed, kept = {count // 2}, []
    for pair in reversed(network):
        if needed.intersection(pair):
            needed.update(pair)
            kept.append(pair)
    return np.array(kept[::-1], np.int64).reshape(-1, 2)


@compiled
def window_medians(first, last, padded, side, pairs, found):
    """Medians of rows `first` to `last`.

    Args:
        first, last: rows to compute.
        padded: (h + side - 1, w + side - 1).
        side: of the window, px.
        pairs: (K, 2), see `comparators`.
        found: (h, w), written.
    """
    width = found.shape[1]
    values = np.empty((side * side, width), padded.dtype)
    for i in range(first, last):
        for k in range(side * side):
            row, into, start = padded[i + k // side], values[k], k % side
            for j in range(width):
                into[j] = row[start + j]
        for k in range(len(pairs)):
            low, high = values[pairs[k, 0]], values[pairs[k, 1]]
            for j in range(width):
                one, other = low[j], high[j]
                low[j] = one if one < other else other
                high[j] = other if one < other else one
        for j in range(width):
            found[i, j] = values[side * side // 2, j]
