"""Compiled loops over samples, in parallel."""

from __future__ import annotations

import functools
import itertools
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from deepir.kernels import ahead

if TYPE_CHECKING:
    from torch import Tensor


class _Cache:
    """numba's cache of one kernel; what it lacks is compiled by processes beside this one.

    Code that was compiled here may call another copy of an inner function than the same code from the cache, and round
    differently: so it is always loaded from the cache.
    """

    def __init__(self, cache: Any, function: Callable[..., Any]) -> None:
        self.cache, self.name = cache, f"{function.__module__.rpartition('.')[2]}.{function.__name__}"

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled kernel; None if it is not in the cache, and nobody else compiles it."""
        found = self.cache.load_overload(signature, context)
        if found is None and ahead.wait_for(self.name):
            found = self.cache.load_overload(signature, context)
        return found

    def __getattr__(self, name: str) -> Any:
        return getattr(self.cache, name)


def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile it for the types it is first called with; it runs without the interpreter's lock.

    Sums may be taken in any order; a NaN stays one.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",  # a division by zero is no exception
        "fastmath": {"contract", "reassoc", "nsz"},
        "no_cfunc_wrapper": True,
    }
    try:
        found: Any = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the cache can be written to
        return njit(**options)(function)
    found._cache = _Cache(found._cache, function)
    return found


def parallel_for(loop: Callable[..., object], count: int, *arguments: Tensor | np.ndarray[Any, Any] | float) -> None:
    """`loop(first, last, *arguments)` on as many parts of `range(count)` as there are threads.

    On threads of Python's own, which sleep until they are needed. Of numba's, one pool does not outlive a fork, and
    the other takes the process down when two threads use it at once.
    """
    from deepir.kernels.threads import alone
    from deepir.kernels.threads import count as available

    arrays = [each if isinstance(each, np.ndarray | float | int) else each.numpy() for each in arguments]
    threads = min(available(), max(count, 1))
    mine, *others = itertools.pairwise(count * i // threads for i in range(threads + 1))
    waiting = [_pool(os.getpid()).submit(alone, loop, *part, *arrays) for part in others]
    run = functools.partial(alone, loop) if waiting else loop
    run(*mine, *arrays)
    for each in waiting:
        each.result()


def parallel_map(function: Callable[..., Any], items: Sequence[Any]) -> list[Any]:
    """`function` of each item, on as many threads as there are."""
    found: dict[int, Any] = {}
    parallel_for(lambda first, last: found.update((k, function(items[k])) for k in range(first, last)), len(items))
    return [found[k] for k in range(len(items))]


@functools.cache
def _pool(process: int) -> ThreadPoolExecutor:
    """The threads of this process: a fork has none of its parent's."""
    return ThreadPoolExecutor(os.cpu_count(), thread_name_prefix="deepir")
