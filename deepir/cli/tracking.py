"""Frames counted on the screen while they are read: a bar in a terminal, lines elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from deepir.cli.terminal import echo

LINE_EVERY = 10.0  # s between lines where there is no terminal

T = TypeVar("T")


def track(frames: Iterable[T], what: str, total: int | None = None) -> Iterator[T]:
    """Pass frames on, and show how many there were and, with a `total`, how long the others take."""
    if sys.stderr.isatty():
        yield from _with_bar(frames, what, total)
        return
    begun = said = time.monotonic()
    for count, frame in enumerate(frames):
        if (now := time.monotonic()) - said > LINE_EVERY:
            said = now
            left = f" of {total}, {(now - begun) / count * (total - count):.0f} s to go" if total else ""
            echo(f"{what}: {count} frames{left}", err=True)
        yield frame


def _with_bar(frames: Iterable[T], what: str, total: int | None) -> Iterator[T]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description:>12}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        yield from bar.track(frames, total=total, description=what)
