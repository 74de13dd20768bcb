"""Kernels compiled into numba's cache by processes beside this one, before they are needed.

numba compiles one kernel after another under a lock of its own, and a run needs two dozen: on a new machine that takes
the time of ten runs. So the first kernel that is not in the cache starts processes which compile all that a run of this
kind needs, in the order in which it needs them.
"""

from __future__ import annotations

import functools
import importlib
import itertools
import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterable
from pathlib import Path

#: Kernels with the types that they are called with, in the order of their first use: of bursts, and of recordings.
SIGNATURES = Path(__file__).with_name("signatures.txt")
MAX_PROCESSES = 6  # more have nothing left to do while the longest kernels are compiled
#: What one of the processes runs; it finds the package where this one does.
PROGRAM = "import sys; sys.path[:0] = sys.argv[1:2]; from deepir.kernels import ahead; ahead.compile_all(sys.argv[2:])"

log = logging.getLogger("deepir")
_beside = False  # this process is one of them


def wait_for(name: str) -> bool:
    """Wait until a kernel is in the cache; false if no process compiles it."""
    if _beside:
        return False
    done = _done(os.getpid())
    if name not in done and (lines := _list_with(name)):
        if not done:
            log.warning("compiling kernels for this machine, once: 5 to 15 s")
        lines = [each for each in lines if _name(each) not in done]
        done.update((_name(each), threading.Event()) for each in lines)
        for share in _shares(lines, min(max(os.cpu_count() or 1, 2), MAX_PROCESSES)):
            threading.Thread(target=_compile_beside, args=(share, done), daemon=True).start()
    return name in done and done[name].wait()


def compile_all(lines: Iterable[str]) -> None:
    """Compile kernels, given as lines of `SIGNATURES`, into the cache, and print the name of each when it is there."""
    from numba.core.sigutils import normalize_signature

    global _beside  # noqa: PLW0603 - a process has one task
    _beside = True
    for name, each in itertools.groupby(lines, _name):
        module, _, function = name.partition(".")
        kernel = getattr(importlib.import_module(f"deepir.kernels.{module}"), function)
        for line in each:
            kernel.compile(normalize_signature(line.removeprefix(name))[0])
        print(name, flush=True)


def compile_everything() -> None:
    """Compile the kernels of all lists, so that the first run does not wait."""
    for line in filter(None, SIGNATURES.read_text(encoding="utf-8").splitlines()):
        wait_for(_name(line))


@functools.cache
def _done(process: int) -> dict[str, threading.Event]:
    """Kernels that are compiled beside this process, and whether each is in the cache; a fork begins anew."""
    return {}


def _compile_beside(lines: list[str], done: dict[str, threading.Event]) -> None:
    """Compile in a process, and note each kernel that is in the cache; in the end, those that could not be compiled."""
    command = [sys.executable, "-c", PROGRAM, str(Path(__file__).parents[2]), *lines]
    try:
        with subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, encoding="ascii"
        ) as process:
            for name in process.stdout or ():
                done[name.strip()].set()
    except OSError:  # no process can be started: kernels are compiled where they are called
        pass
    for line in lines:
        done[_name(line)].set()


def _list_with(name: str) -> list[str]:
    """Lines of the first list that holds a kernel."""
    lists = [each.splitlines() for each in SIGNATURES.read_text(encoding="utf-8").split("\n\n")]
    return next((each for each in lists if name in map(_name, each)), [])


def _shares(lines: list[str], count: int) -> list[list[str]]:
    """Lines for each process, in their order. All of a module are one's: two would write to one index of the cache."""
    shares: list[list[str]] = [[] for _ in range(count)]
    modules: dict[str, list[str]] = {}
    for line in lines:
        modules.setdefault(line.partition(".")[0], []).append(line)
    for each in sorted(modules.values(), key=len, reverse=True):
        min(shares, key=len).extend(each)
    return [sorted(each, key=lines.index) for each in shares if each]


def _name(line: str) -> str:
    return line.partition("(")[0]
