"""Progress of a run: a bar in a terminal, lines elsewhere."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import TYPE_CHECKING

from deepir.paths import printable

if TYPE_CHECKING:
    from deepir.optim.solve import Progress


class ProgressLines:
    """Prints a line when a stage begins and ends, and every `every` seconds."""

    def __init__(self, say: Callable[[str], None], every: float = 10.0) -> None:
        self.say, self.every = say, every
        self.start = self.last_printed = time.monotonic()
        self.first: float | None = None
        self.last: Progress | None = None

    def __call__(self, progress: Progress) -> None:
        """Print a line if it is time."""
        now = time.monotonic()
        if self.first is None:
            self.start, self.first = now, progress.done
        if (last := self.last) is not None and last.stage != progress.stage:
            self.say(f"{last.stage} ends at {last.iteration}/{last.iterations}: loss {last.loss:.6g}")
        if last is None or last.stage != progress.stage or now - self.last_printed > self.every:
            self.last_printed = now
            self.say(self._line(progress, now))
        self.last = progress

    def _line(self, progress: Progress, now: float) -> str:
        line = f"{progress.stage} {progress.iteration}/{progress.iterations}: loss {progress.loss:.6g}"
        if math.isfinite(error := progress.held_out()):
            line += f", held-out error {error:.4g}"
        if self.first is not None and (gone := progress.done - self.first) > 0:
            line += f", at most {math.ceil((now - self.start) / gone * (1 - progress.done))} s to go"
        return line


class ProgressBar:
    """A bar on stderr with stage, iteration, loss, held-out error and the time left at most."""

    def __init__(self, every: float = 2.0) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as RichProgress

        self.every, self.last, self.held_out = every, -math.inf, ""
        self.bar = RichProgress(
            TextColumn("{task.description:>12}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[what]}"),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
        )
        self.task = self.bar.add_task("registering", total=None, what="")

    def __enter__(self) -> ProgressBar:
        self.bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.bar.stop()

    def __call__(self, progress: Progress) -> None:
        """Advance the bar."""
        now = time.monotonic()
        if now - self.last > self.every:
            self.last, error = now, progress.held_out()
            self.held_out = f"  held-out {error:.4g}" if math.isfinite(error) else ""
        what = f"{progress.iteration}/{progress.iterations}  loss {progress.loss:.6g}{self.held_out}"
        self.bar.update(
            self.task, description=printable(progress.stage), total=1.0, completed=progress.done, what=what
        )


@contextmanager
def registering(say: Callable[[str], None], every: float = 10.0) -> Iterator[threading.Event]:
    """A context that says every `every` seconds that frames are registered, until its event is set."""
    begun, start = threading.Event(), time.monotonic()

    def wait() -> None:
        while not begun.wait(every):
            say(f"registering the frames, {time.monotonic() - start:.0f} s so far")

    threading.Thread(target=wait, daemon=True).start()
    try:
        yield begun
    finally:
        begun.set()


def _print_line(line: str) -> None:
    print(printable(line), file=sys.stderr, flush=True)


@contextmanager
def show_progress() -> Iterator[Callable[[Progress], None]]:
    """A context with a callback: a bar in a terminal, lines elsewhere."""
    if sys.stderr.isatty():
        with ProgressBar() as bar:
            yield bar
        return
    with registering(_print_line) as begun:

        def advance(progress: Progress) -> None:
            begun.set()
            lines(progress)

        lines = ProgressLines(_print_line)
        yield advance
