"""Compiled loops over samples, in parallel."""

from __future__ import annotations

import functools
import itertools
import logging
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba import njit
from numba.core import event
from torch import Tensor

from deepir.kernels.threads import count as available

log = logging.getLogger("deepir")


class _FirstUse(event.Listener):
    """Says once why it takes long: a loop is compiled, which is not in the cache."""

    said = False

    def on_start(self, event: event.Event) -> None:
        """Before each."""
        if not self.said:
            log.warning("compiling kernels for this machine: about 20 s, once")
        self.said = True

    def on_end(self, event: event.Event) -> None:
        """After each."""


event.register("numba:compile", _FirstUse())


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile it for the types it is first called with; it runs without the interpreter's lock.

    Sums may be taken in any order; a NaN stays one.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",  # a division by zero is no exception
        "fastmath": {"contract", "reassoc", "nsz"},
    }
    try:
        found: Callable[..., Any] = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache can be written to
        found = njit(**options)(function)
    return found


def parallel_for(
    loop: Callable[..., None], count: int, *arguments: Tensor | np.ndarray[Any, Any] | float
) -> None:
    """`loop(first, last, *arguments)` on as many parts of `range(count)` as there are threads.

    On threads of Python's own, which sleep until they are needed. Of numba's, one pool does not outlive a fork, and
    the other takes the process down when two threads use it at once.
    """
    arrays = [each.numpy() if isinstance(each, Tensor) else each for each in arguments]
    threads = min(available(), max(count, 1))
    mine, *others = itertools.pairwise(count * i // threads for i in range(threads + 1))
    waiting = [_pool(os.getpid()).submit(loop, *part, *arrays) for part in others]
    loop(*mine, *arrays)
    for each in waiting:
        each.result()


@functools.cache
def _pool(process: int) -> ThreadPoolExecutor:
    """The threads of this process: a fork has none of its parent's."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="deepir")
