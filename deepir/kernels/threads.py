"""Threads of a solve on the CPU: one for small bursts, for large ones all, of the compiled loops and of torch.

To wake a thread takes as long as a small burst's loops do. The loops' threads sleep until they are needed, torch's
spin for a moment while they wait for each other.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import torch

#: Samples of a burst from which a second thread is faster.
MIN_PARALLEL_SAMPLES = 400_000

_given = ContextVar("threads", default=0)


def count() -> int:
    """Number of threads of a compiled loop: that of the running solve, or else that of torch."""
    return _given.get() or torch.get_num_threads()


@contextlib.contextmanager
def for_burst(samples: int, max_threads: int | None = None) -> Iterator[None]:
    """Context with threads for a number of samples: one, or `max_threads` (those of torch if None) for large bursts."""
    before = torch.get_num_threads()
    number = (max_threads or count()) if samples >= MIN_PARALLEL_SAMPLES else 1
    token = _given.set(number)
    torch.set_num_threads(number)
    try:
        yield
    finally:
        _given.reset(token)
        torch.set_num_threads(before)
