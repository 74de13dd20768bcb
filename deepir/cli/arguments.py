"""Arguments that commands share, and where their results go."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.io.radiometry import Radiometry

Settings = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Settings, for example data.path=burst.npz")
]
ReadingSettings = Annotated[
    list[str] | None, typer.Argument(metavar="KEY=VALUE", help="Settings, for example data.axes=hwn")
]
Plugins = Annotated[
    list[str] | None,
    typer.Option("--plugin", metavar="MODULE", help="Python module that registers components; may be repeated."),
]
ConfigName = Annotated[str, typer.Argument(metavar="CONFIG", help="A shipped configuration (nuc) or a .yaml file.")]
CorrectedOutput = Annotated[
    Path | None, typer.Option(help="A .tif, or an .mp4 to look at; FILE_corrected.tif unless given.")
]
Float32 = Annotated[bool, typer.Option("--float32", help="Do not round to the recording's type.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]
#: Of how a file is read.
DATA_SETTINGS = ("data.key", "data.raw", "data.axes", "data.swap_bytes", "data.radiometry", "data.crop")
#: Of how it is read and displayed.
RECORDING_SETTINGS = (*DATA_SETTINGS, "data.frames", "output.palette", "output.tones")


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
    found = readers.opened(expanded(str(data.path)), data.key).radiometries()[0] if data.raw is None else None
    return resolve_radiometry(found, data.radiometry)


def config_stem(name: str) -> str:
    """Name of a configuration without folder and suffix, for the default output folder.

    Args:
        name: A shipped configuration, or a .yaml file.
    """
    return Path(name).stem if Path(name).is_file() else name


@contextmanager
def held_outputs(*paths: Path, overwrite: bool, suffix: str = "", source: str | Path | None = None) -> Iterator[None]:
    """A context in which no other process writes these files.

    Args:
        paths: The files.
        overwrite: They may be there.
        suffix: With which their names must end, such as ".npz"; empty: any.
        source: A file that must not be among them.

    Raises:
        DeepIRError: A file is there, or is the source; a name ends otherwise; their folder is missing; another process
            writes them.
    """
    from deepir.errors import DataError
    from deepir.storage.folder import locked_files

    for path in paths:
        if suffix and (path.suffix != suffix or not path.parent.is_dir()):
            raise DataError(f"{path}: give a file name that ends in {suffix}, in a folder that exists")
        if not path.parent.is_dir():
            raise DataError(f"{path}: cannot be written: there is no folder {path.parent}")
    with locked_files(*paths):
        for path in paths:
            if path.exists() and source is not None and Path(source).exists() and path.samefile(source):
                raise DataError(f"{path} is the recording itself: give another --output")
            if path.exists() and not overwrite:
                raise DataError(f"{path} exists; replace it with --overwrite, or give another name")
        yield
