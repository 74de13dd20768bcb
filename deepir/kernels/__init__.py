"""Loops over samples for the CPU, compiled by numba on first use and kept in its cache.

Import its modules where they are first needed, or `run` a loop by its name: numba takes 0.2 s. A loop is
`loop(first, last, ...)`, for `compile.parallel_for`. It writes to no element that another part of the range writes to,
so that the result does not depend on the number of threads.
"""

from __future__ import annotations

import importlib
from typing import Any


def run(name: str, count: int, *arguments: Any) -> None:
    """Run a loop, called `module.function` as in `signatures.txt`, on `range(count)`; see `compile.parallel_for`."""
    from deepir.kernels.compile import parallel_for

    module, _, function = name.partition(".")
    parallel_for(getattr(importlib.import_module(f"{__name__}.{module}"), function), count, *arguments)
