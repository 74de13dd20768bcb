# mypy: disable-error-code="no-untyped-def"
"""Medians over frames, and of windows of a picture."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from deepir.kernels.compile import compiled, parallel_for

#: Bits that one pass of the radix selection separates.
BITS_PER_DIGIT = 11
#: Passes: 33 bits hold a float32 and its sign.
N_DIGITS = 3
Array = np.ndarray[Any, Any]
MIN_PARALLEL_PIXELS = 100_000  # of a picture, from which a second thread is faster


@compiled
def median(first, last, bits, found):
    """Of float32 numbers, given by their `bits` (K,), the lower one of two; `found` (1,): its bits.

    No pass branches by what it reads, which is next to random.
    """
    keys, left = np.empty(len(bits), np.int64), len(bits)
    for i in range(left):
        value = np.int64(bits[i])
        keys[i] = value + 0x80000000 if value >= 0 else -1 - value
    size, rank, key = np.empty(1 << BITS_PER_DIGIT, np.int64), (left - 1) // 2, 0
    for digit in range(N_DIGITS):
        shift = (N_DIGITS - 1 - digit) * BITS_PER_DIGIT
        size[:] = 0
        for i in range(left):
            size[(keys[i] >> shift) & (len(size) - 1)] += 1
        at = 0
        while rank >= size[at]:
            rank -= size[at]
            at += 1
        key, count, left = (key << BITS_PER_DIGIT) + at, left, 0
        for i in range(count):
            keys[left] = keys[i]
            left += keys[i] >> shift == key
    found[0] = key - 0x80000000 if key >= 0x80000000 else -1 - key


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
