"""Progress of solves and of recordings: a bar in a terminal, lines elsewhere."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from deepir.paths import printable

if TYPE_CHECKING:
    from rich.progress import Progress as RichProgress

    from deepir.optim.solve import Progress

LINE_INTERVAL = 10.0  # s between lines where there is no terminal
T = TypeVar("T")


class ProgressLines:
    """Prints a line when a stage begins and ends, and every `LINE_INTERVAL`."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
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
        if last is None or last.stage != progress.stage or now - self.last_printed > LINE_INTERVAL:
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
    """Advances a bar with stage, iteration, loss, held-out error and the time left at most."""

    def __init__(self, bar: RichProgress) -> None:
        self.bar = bar
        self.last, self.held_out = -math.inf, ""
        self.task = bar.add_task("registering", total=None, what="")

    def __call__(self, progress: Progress) -> None:
        """Advance the bar."""
        now = time.monotonic()
        if now - self.last > 2:  # s
            self.last, error = now, progress.held_out()
            self.held_out = f"  held-out {error:.4g}" if math.isfinite(error) else ""
        what = f"{progress.iteration}/{progress.iterations}  loss {progress.loss:.6g}{self.held_out}"
        self.bar.update(self.task, description=printable(progress.stage), total=1.0, completed=progress.done, what=what)


def _bar(column: Any) -> RichProgress:
    """A bar on stderr with a name, a column of its own and the time left; it is removed at its end."""
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as RichProgress

    columns = TextColumn("{task.description:>12}"), BarColumn(bar_width=24), column, TimeRemainingColumn()
    return RichProgress(*columns, console=Console(stderr=True), transient=True)


@contextmanager
def registering(say: Callable[[str], None], every: float = LINE_INTERVAL) -> Iterator[threading.Event]:
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
        from rich.progress import TextColumn

        with _bar(TextColumn("{task.fields[what]}")) as bar:
            yield ProgressBar(bar)
        return
    with registering(_print_line) as begun:

        def advance(progress: Progress) -> None:
            begun.set()
            lines(progress)

        lines = ProgressLines(_print_line)
        yield advance


def track(frames: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Pass frames on, and show how many there were and, with a `total`, how long the others take."""
    if sys.stderr.isatty():
        from rich.progress import MofNCompleteColumn

        with _bar(MofNCompleteColumn()) as bar:
            yield from bar.track(frames, total=total, description=what)
        return
    begun = printed = time.monotonic()
    for count, frame in enumerate(frames):
        if count and (now := time.monotonic()) - printed > LINE_INTERVAL:
            printed = now
            left = f" of {total}, {(now - begun) / count * (total - count):.0f} s to go" if total else ""
            _print_line(f"{what}: {count} frames{left}")
        yield frame
