"""Threads of a solve on the CPU: the compiled loops share them, torch's own operations take one.

Those are bound by memory, and gain next to nothing from a second. But torch's threads spin while they wait for each
other, so that a solve takes ten times as long where another program has one of the cores.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import torch

_given = ContextVar("threads", default=0)


def count() -> int:
    """How many threads a loop is spread over; as many as torch has, unless a solve runs."""
    return _given.get() or torch.get_num_threads()


@contextlib.contextmanager
def for_loops(number: int | None) -> Iterator[None]:
    """While it lasts, loops have so many threads, torch's by default, and torch has one."""
    before = torch.get_num_threads()
    token = _given.set(number or count())
    torch.set_num_threads(1)
    try:
        yield
    finally:
        _given.reset(token)
        torch.set_num_threads(before)
