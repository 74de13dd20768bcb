"""Ctrl-C and SIGTERM: a run stops where it can be continued."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from types import FrameType, TracebackType
from typing import TYPE_CHECKING, Any

from deepir.cli.terminal import notify

if TYPE_CHECKING:
    from deepir.optim.solve import Progress

HANDLED_SIGNALS = (signal.SIGINT, signal.SIGTERM)  # signals that end a run where it can be continued


class Interrupted(BaseException):
    """The run is to stop; `status` is the exit status."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"signal {signum}")
        self.status = 128 + signum


class Interruptible:
    """A context in which a signal ends the solve after its iteration; a second or an early one ends it at once.

    It is also the callback of the solve: if it raises, the solver saves its state first.
    """

    def __init__(self) -> None:
        self.solving, self.requested = False, 0
        self.previous: dict[int, Any] = {}

    def __enter__(self) -> Interruptible:
        self.previous = {signum: signal.signal(signum, self._handle) for signum in HANDLED_SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for signum, handler in self.previous.items():
            signal.signal(signum, handler)

    def __call__(self, progress: Progress) -> None:
        """Raise `Interrupted` if a signal has come."""
        self.solving = True
        if self.requested:
            raise Interrupted(self.requested)

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        if self.requested or not self.solving:
            raise Interrupted(signum)
        self.requested = signum
        os.write(2, b"\ndeepir: stopping after this iteration; once more stops at once\n")


def report_interrupted(error: Interrupted, folder: Path) -> int:
    """Print how to continue an interrupted run; the exit status."""
    from deepir.storage.folder import RunFolder

    run = RunFolder(folder).active
    if run.checkpoint.exists():
        what = f"interrupted; go on with: deepir resume {folder}"
    elif run.config.exists():
        what = f"interrupted before the first checkpoint; start again with: deepir resume {folder}"
    else:
        what = "interrupted before anything was written"
    notify(what)
    return error.status


def report_aborted(error: Interrupted) -> int:
    """Print that a command that cannot be continued has written nothing; the exit status."""
    notify("interrupted; nothing was written")
    return error.status
