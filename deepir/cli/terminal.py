"""The terminal: progress, colours, and signals that end a command."""

from __future__ import annotations

import logging
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any, TextIO, cast

from deepir.errors import DataError
from deepir.paths import printable

if TYPE_CHECKING:
    from deepir.optim.solve import Progress

HANDLED_SIGNALS = (signal.SIGINT, signal.SIGTERM)  # signals that end a run where it can be continued


def echo(line: str, *, err: bool = False) -> None:
    """Print one line; control characters, as names of files may hold them, are escaped."""
    print(printable(line), file=sys.stderr if err else sys.stdout, flush=True)


def notify(line: str) -> None:
    """Print one line on stderr, after the program's name."""
    echo(f"deepir: {line}", err=True)


class WarningHandler(logging.Handler):
    """Prints the package's warnings on stderr."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a warning; other records are for the log."""
        if record.levelno == logging.WARNING:
            notify(record.getMessage())


@contextmanager
def printed_warnings() -> Iterator[None]:
    """A context in which warnings of the package are printed."""
    handler, log = WarningHandler(), logging.getLogger("deepir")
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)


@contextmanager
def standard_streams() -> Iterator[None]:
    """A context in which work goes on if a stream is closed, or its reader has gone; the text is dropped."""
    _open_closed_descriptors()
    streams = sys.stdin, sys.stdout, sys.stderr
    sys.stdin = streams[0] or _nowhere("r")
    sys.stdout = cast(TextIO, _Lenient(streams[1] or _nowhere("w"), needed=True))
    sys.stderr = cast(TextIO, _Lenient(streams[2] or _nowhere("w"), needed=False))
    try:
        yield
    finally:
        with suppress(DataError):
            sys.stdout.flush()
            sys.stderr.flush()
        sys.stdin, sys.stdout, sys.stderr = streams


class _Lenient:
    """A text stream that drops its text once the reader has gone, and escapes what its encoding lacks.

    If it is `needed`, another fault is an error, such as a full disk below it.
    """

    def __init__(self, stream: TextIO, *, needed: bool) -> None:
        self._stream, self._needed = stream, needed
        with suppress(AttributeError, ValueError):
            cast(Any, stream).reconfigure(errors="backslashreplace")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        self._try(self._stream.write, text)
        return len(text)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, call: Any, *arguments: str) -> None:
        try:
            call(*arguments)
        except OSError as error:
            _drop(self._stream)  # else the interpreter tries again when it ends
            if self._needed and not isinstance(error, BrokenPipeError):
                raise DataError(f"standard output cannot be written: {error.strerror or error}") from error


def _drop(stream: Any) -> None:
    """Lead a stream to nowhere, with what it has not written yet."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def _open_closed_descriptors() -> None:
    """Open closed standard descriptors to nowhere: else the next file would get their numbers, and be printed into."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the least free number


def _nowhere(mode: str) -> TextIO:
    return cast(TextIO, open(os.devnull, mode, encoding="utf-8"))  # noqa: PTH123 - for the rest of the process


class Interrupted(BaseException):
    """The command is to stop; `status` is the exit status, `outcome` says what becomes of its work."""

    def __init__(self, signum: int) -> None:
        super().__init__(f"signal {signum}")
        self.status = 128 + signum
        self.outcome = "interrupted; nothing was written"


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

    def __exit__(self, *_: object) -> None:
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


@contextmanager
def watched_solve(folder: Path | None = None) -> Iterator[list[Callable[[Progress], None]]]:
    """A context with the callbacks of a solve: its progress on stderr, and its end by a signal.

    Args:
        folder: Of the run, which may be continued; None: nothing is written.
    """
    from deepir.report.progress import show_progress

    try:
        with Interruptible() as interruptible, show_progress() as progress:
            yield [interruptible, progress]
    except Interrupted as error:
        if folder is not None:
            error.outcome = _continuation(folder)
        raise


def _continuation(folder: Path) -> str:
    """How to continue an interrupted run."""
    from deepir.storage.folder import RunFolder

    run = RunFolder(folder).active
    if run.checkpoint.exists():
        return f"interrupted; go on with: deepir resume {folder}"
    if run.config.exists():
        return f"interrupted before the first checkpoint; start again with: deepir resume {folder}"
    return "interrupted before anything was written"
