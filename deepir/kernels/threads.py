"""Where a kernel runs, and on how many threads: one for small bursts; for large ones all, of the compiled loops.

To wake a thread takes as long as a small burst's loops do. Torch's operations on a burst are short too, and its threads
wait for each other after every one: on a busy machine, or with as many threads as a processor has hyperthreads, an
estimate takes several times as long. So only layers of networks have torch's threads, and no product has BLAS's.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from typing import TYPE_CHECKING

from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from torch import Tensor

MIN_DEPTH = 1e-3  # smallest depth of a projected point
ENABLED = True  # false: the twins compute on the CPU too, so that tests can compare them with the loops
MIN_PARALLEL_SAMPLES = 400_000  # samples of a burst from which a second thread is faster
#: Threads unless others are asked for. On 16 hyperthreads, 1, 2, 4, 8 and 16 took 15, 10, 7, 5.6 and 14 s.
MAX_THREADS = 8

_given = ContextVar("threads", default=0)


def is_compiled(value: Tensor) -> bool:
    """Whether a compiled loop computes on a tensor: on the CPU alone."""
    return ENABLED and value.device.type == "cpu"


def available() -> int:
    """Number of threads of an estimate that is given none."""
    torch = sys.modules.get("torch")  # without it, what needs it has not run
    cores = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))  # Linux alone has it
    return min(torch.get_num_threads() if torch else len(cores(0)), MAX_THREADS)


def count() -> int:
    """Number of threads of a compiled loop."""
    return _given.get() or available()


def alone(loop: Callable[..., object], *arguments: object) -> None:
    """Call a loop, whose own loops do not share their work with other threads."""
    token = _given.set(1)
    try:
        loop(*arguments)
    finally:
        _given.reset(token)


@contextlib.contextmanager
def for_samples(samples: int, max_threads: int | None = None) -> Iterator[None]:
    """Context with threads for a number of samples: one, or `max_threads` (None: `available`) for many samples."""
    number = (max_threads or count()) if samples >= MIN_PARALLEL_SAMPLES else 1
    token = _given.set(number)
    try:
        with _threads_of_torch(1), threadpool_limits(1, "blas"):
            yield
    finally:
        _given.reset(token)


@contextlib.contextmanager
def for_layers(wanted: bool = True) -> Iterator[None]:
    """Context in which torch's operations have the threads of the compiled loops, if wanted."""
    with _threads_of_torch(count()) if wanted else contextlib.nullcontext():
        yield


@contextlib.contextmanager
def _threads_of_torch(number: int) -> Iterator[None]:
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch else 0
    try:
        if torch:
            torch.set_num_threads(number)
        yield
    finally:
        if torch:
            torch.set_num_threads(before)
