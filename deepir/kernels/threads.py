"""Threads of a solve on the CPU: one for small bursts, for large ones all, of the compiled loops and of torch.

To wake a thread takes as long as a small burst's loops do. The loops' threads sleep until they are needed, torch's
spin for a moment while they wait for each other.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import torch

#: Samples of a burst from which a second thread pays.
LARGE = 400_000

_given = ContextVar("threads", default=0)


def count() -> int:
    """How many threads a loop is spread over; as many as torch has, unless a solve runs."""
    return _given.get() or torch.get_num_threads()


@contextlib.contextmanager
def for_burst(samples: int, most: int | None = None) -> Iterator[None]:
    """While it lasts, loops and torch have what threads suit so many samples: one, or `most`, torch's by default."""
    before = torch.get_num_threads()
    number = (most or count()) if samples >= LARGE else 1
    token = _given.set(number)
    torch.set_num_threads(number)
    try:
        yield
    finally:
        _given.reset(token)
        torch.set_num_threads(before)
