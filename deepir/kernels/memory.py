"""Memory of the process: its peak, and freed pages that are kept, as fresh ones cost up to ten passes to be zeroed."""

from __future__ import annotations

import contextlib
import ctypes
import sys
import threading
from collections.abc import Iterator
from typing import Any

TRIM_THRESHOLD = -1  # option of mallopt: free memory at the top of the heap that is kept, bytes (glibc, malloc.h)
MMAP_THRESHOLD = -3  # option of mallopt: size from which arrays get pages of their own, bytes (glibc, malloc.h)
MMAP_MAX = -4  # option of mallopt: largest number of such arrays (glibc, malloc.h)
#: Values afterwards: the largest that glibc itself adapts to.
RESTORED_OPTIONS = {TRIM_THRESHOLD: 2**26, MMAP_THRESHOLD: 2**25, MMAP_MAX: 2**16}

_lock = threading.Lock()
_open_contexts = 0


@contextlib.contextmanager
def kept() -> Iterator[None]:
    """Context in which freed memory stays in the process; at the end of the outermost it is returned.

    Contexts may be nested, and of several threads. Only with glibc (Linux).
    """
    global _open_contexts  # noqa: PLW0603 - options of the process
    with _lock:
        _open_contexts += 1
        if _open_contexts == 1 and (libc := _glibc()):
            libc.mallopt(TRIM_THRESHOLD, 2**31 - 1)
            libc.mallopt(MMAP_MAX, 0)
    try:
        yield
    finally:
        with _lock:
            _open_contexts -= 1
            if _open_contexts == 0 and (libc := _glibc()):
                for option, value in RESTORED_OPTIONS.items():
                    libc.mallopt(option, value)
                libc.malloc_trim(0)


def _glibc() -> Any:
    """The C library if it is glibc, else None."""
    try:
        libc = ctypes.CDLL("libc.so.6")
    except OSError:
        return None
    return libc if hasattr(libc, "mallopt") and hasattr(libc, "malloc_trim") else None


def peak_memory() -> float | None:
    """Peak memory of this process, MB; None where the system does not say, as Windows."""
    try:
        import resource
    except ModuleNotFoundError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (2**20 if sys.platform == "darwin" else 2**10), 1)
