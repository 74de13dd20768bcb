"""Arguments that commands share, and where their results go."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.io.radiometry import Radiometry

Settings = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="Settings, for example data.path=burst.npz", show_default=False),
]
ReadingSettings = Annotated[
    list[str] | None,
    typer.Argument(metavar="KEY=VALUE", help="Settings, for example data.axes=hwn", show_default=False),
]
Plugins = Annotated[
    list[str] | None,
    typer.Option(
        "--plugin", metavar="MODULE", help="Python module that registers components; may be repeated."
    ),
]
DATA_SETTINGS = (
    "data.key",
    "data.raw",
    "data.axes",
    "data.swap_bytes",
    "data.radiometry",
    "data.crop",
)  # of how a file is read
RECORDING_SETTINGS = (*DATA_SETTINGS, "output.palette", "output.tones")  # of how it is read and displayed
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
LINE_EVERY = 10.0  # s between lines where there is no terminal
T = TypeVar("T")


def load_plugins(modules: Sequence[str] | None) -> list[str]:
    """Import plugin modules, from the current folder too.

    Returns:
        Their names.

    Raises:
        ConfigError: One cannot be imported.
    """
    from deepir.registry import load_plugin

    if modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    for module in modules or ():
        load_plugin(module)
    return list(modules or ())


def split_arguments(what: Sequence[str]) -> tuple[list[str], list[str]]:
    """Split the arguments of a command that takes many of both into files and settings."""
    settings = [each for each in what if "=" in each and not os.path.exists(each)]  # noqa: PTH110 - however long
    return [each for each in what if each not in settings], settings


def recording_config(file: str, settings: Sequence[str], keys: Sequence[str]) -> Config:
    """The configuration for reading and displaying one file.

    Args:
        file: The file.
        settings: `KEY=VALUE` of the user.
        keys: Keys that the command accepts.

    Raises:
        ConfigError: A setting is none of `keys`.
    """
    from deepir.config import load
    from deepir.errors import ConfigError

    for each in settings:
        if not each.startswith(tuple(f"{key}{end}" for key in keys for end in "=.")):
            raise ConfigError(
                f"{each}: only settings of {', '.join(keys)} are accepted here; options start with dashes"
            )
    return load("nuc", [f"data.path={file}", *settings])


def recording_radiometry(config: Config) -> Radiometry | None:
    """Conversion of a recording's values to kelvin: of the file, as the settings change it."""
    from deepir.io import readers
    from deepir.io.radiometry import resolve_radiometry
    from deepir.paths import expanded

    data = config.data
    found = readers.radiometry(expanded(str(data.path)), data.key) if data.raw is None else None
    return resolve_radiometry(found, data.radiometry)


def check_output_name(path: Path, suffix: str) -> None:
    """Check the name of an output file: its suffix, such as ".npz", and its folder.

    Raises:
        DataError: It has another suffix, or its folder is missing.
    """
    from deepir.errors import DataError

    if path.suffix != suffix or not path.parent.is_dir():
        raise DataError(f"{path}: give a file name that ends in {suffix}, in a folder that exists")


def config_stem(name: str) -> str:
    """Name of a configuration without folder and suffix, for the default output folder.

    Args:
        name: A shipped configuration, or a .yaml file.
    """
    return Path(name).stem if Path(name).is_file() else name


@contextmanager
def held_outputs(*paths: Path, overwrite: bool, source: str | Path | None = None) -> Iterator[None]:
    """A context in which no other process writes these files.

    Args:
        paths: The files.
        overwrite: They may be there.
        source: A file that must not be among them.

    Raises:
        DeepIRError: A file is there, or is the source; their folder is missing; another process writes them.
    """
    from deepir.errors import DataError
    from deepir.storage.folder import locked_files

    for path in paths:
        if not path.parent.is_dir():
            raise DataError(f"{path}: cannot be written: there is no folder {path.parent}")
    with locked_files(*paths):
        for path in paths:
            if path.exists() and source is not None and Path(source).exists() and path.samefile(source):
                raise DataError(f"{path} is the recording itself: give another --output")
            if path.exists() and not overwrite:
                raise DataError(f"{path} exists; replace it with --overwrite, or give another name")
        yield


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
