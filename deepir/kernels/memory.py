"""Memory that is freed is kept for the next array: large arrays from the system cost a pass, or ten, to be zeroed."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator

#: Options of glibc's mallopt (malloc.h), with what they are to be afterwards: what glibc itself adapts to at most.
TRIM_THRESHOLD, MMAP_THRESHOLD, MMAP_MAX = -1, -3, -4
AFTER = {TRIM_THRESHOLD: 2**26, MMAP_THRESHOLD: 2**25, MMAP_MAX: 2**16}


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """While it lasts, free memory stays with the process; then it is given back. Only with glibc (Linux)."""
    try:
        libc = ctypes.CDLL("libc.so.6")
        known = libc.mallopt, libc.malloc_trim
    except (OSError, AttributeError):  # another C library
        yield
        return
    mallopt, trim = known
    mallopt(TRIM_THRESHOLD, 2**31 - 1)
    mallopt(MMAP_MAX, 0)
    try:
        yield
    finally:
        for option, value in AFTER.items():
            mallopt(option, value)
        trim(0)
