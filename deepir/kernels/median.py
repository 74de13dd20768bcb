# mypy: disable-error-code="no-untyped-def"
"""The median of many numbers, from their bits: these have the same order as whole numbers."""

from __future__ import annotations

import numpy as np

from deepir.kernels.compile import compiled

#: Bits that one pass of the radix selection separates.
BITS_PER_DIGIT = 11
#: Passes: 33 bits hold a float32 and its sign.
N_DIGITS = 3


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
