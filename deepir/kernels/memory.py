"""Keep freed memory in the process: fresh pages from the system cost up to ten passes to be zeroed."""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Iterator

#: Option of mallopt: free memory at the top of the heap that is kept, bytes (glibc, malloc.h).
TRIM_THRESHOLD = -1
#: Option of mallopt: size from which arrays get pages of their own, bytes (glibc, malloc.h).
MMAP_THRESHOLD = -3
#: Option of mallopt: largest number of such arrays (glibc, malloc.h).
MMAP_MAX = -4
#: Values afterwards: the largest that glibc itself adapts to.
RESTORED_OPTIONS = {TRIM_THRESHOLD: 2**26, MMAP_THRESHOLD: 2**25, MMAP_MAX: 2**16}


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """Context in which freed memory stays in the process; it is returned at the end. Only with glibc (Linux)."""
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
        for option, value in RESTORED_OPTIONS.items():
            mallopt(option, value)
        trim(0)
