"""The work of a worker: one cell."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from deepir.errors import DeepIRError
from deepir.registry import load_plugin
from deepir.storage.stored import resume, run_into
from deepir.sweep.cells import Cell

#: One run at a time: torch's seed and the package's log belong to the process.
PROCESS_LOCK = threading.Lock()


def finish_cell(cell: Cell, plugins: Sequence[str] = ()) -> str | None:
    """Run a cell, or continue it where a lost worker left it; its error in one line, or None."""
    with PROCESS_LOCK:
        try:
            for each in plugins:
                load_plugin(each)
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


def _forget_peak_memory() -> None:
    """Reset this process's peak memory on Linux; elsewhere the peak is that of all cells so far."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
