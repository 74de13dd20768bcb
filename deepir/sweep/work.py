"""A run of a sweep in a process of its own."""

from __future__ import annotations

import signal
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from distributed import Worker, WorkerPlugin

from deepir.config import Config, Data
from deepir.config.schema import Output, Solver
from deepir.errors import DeepIRError
from deepir.registry import load_plugin
from deepir.runner import execute, prepare
from deepir.simulate import Settings, simulate
from deepir.storage.stored import resume, run_into
from deepir.sweep.cells import Cell

#: One run at a time: torch's seed and the package's log belong to the process.
PROCESS_LOCK = threading.Lock()
#: Size of the frames by which a process is warmed up, px.
WARM_UP_SHAPE = (40, 48)


class IgnoreInterrupts(WorkerPlugin):
    """Ignore Ctrl-C, which a terminal sends to the workers too; each would end with a traceback."""

    name = "deepir-uninterrupted"

    def setup(self, worker: Worker) -> None:
        """Called in the main thread of each worker as it starts, replacements included."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)


_warm: set[str] = set()  # what this process has run


def finish_cell(cell: Cell, plugins: Sequence[str] = ()) -> str | None:
    """Run a cell, or continue it where a lost worker left it; its error in one line, or None."""
    with PROCESS_LOCK:
        try:
            for each in plugins:
                load_plugin(each)
            _warm_up(cell.config)
            _forget_peak_memory()
            state = cell.folder.state()
            if state == "interrupted":
                resume(cell.folder.path, plugins=plugins)
            elif state == "new":
                run_into(cell.config, cell.folder.path, plugins=plugins)
        except DeepIRError as error:
            return " ".join(str(error).split())
        except Exception as error:  # whatever it is, it ends this cell only
            return " ".join(f"{type(error).__name__}: {error}".split())
    return None


def _warm_up(config: Config) -> None:
    """Run small frames first, once for each method in a process: loading and compiling is no part of its seconds."""
    kind = config.model_dump_json(include={"problem", "method", "prior", "physics", "device"})
    if kind in _warm:
        return
    _warm.add(kind)
    small = config.model_copy(
        update={"data": Data(fps=config.data.fps), "output": Output(), "solver": Solver(max_iterations=1)}
    )
    with suppress(Exception):  # the run itself says what is wrong
        frames = simulate(settings=Settings(shape=WARM_UP_SHAPE, n_frames=4)).frames
        execute(small, prepare(small, frames))


def _forget_peak_memory() -> None:
    """Reset this process's peak memory on Linux; elsewhere the peak is that of all cells so far."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
